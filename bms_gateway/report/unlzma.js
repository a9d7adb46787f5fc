"use strict";
// Unpacks a raw LZMA stream (lc = 3, lp = 0, pb = 0, with an end marker) that gives `length` bytes; anything else is an error.
function unlzma(packed, length) {
  const out = new Uint8Array(length);
  const odds = (n) => new Uint16Array(n).fill(1024);
  const lengths = () => ({ choice: odds(2), low: odds(8), mid: odds(8), high: odds(256) });
  const literal = odds(0x300 * 8), isMatch = odds(12), isRep = odds(12), isRep0 = odds(12), isRep1 = odds(12), isRep2 = odds(12), isLong = odds(12);
  const slots = odds(4 * 64), special = odds(128), align = odds(16), matched = lengths(), repeated = lengths();
  const c = new Uint32Array([0xffffffff, 0, 5]); // range, code, place: not boxed
  for (let i = 1; i < 5; i++) c[1] = (c[1] << 8) | packed[i];

  function bit(p, i) {
    const odd = p[i], bound = (c[0] >>> 11) * odd;
    let found = 0;
    if (c[1] < bound) { c[0] = bound; p[i] = odd + ((2048 - odd) >>> 5); }
    else { c[0] -= bound; c[1] -= bound; p[i] = odd - (odd >>> 5); found = 1; }
    if (c[0] < 0x1000000) { c[0] <<= 8; c[1] = (c[1] << 8) | packed[c[2]++]; }
    return found;
  }
  function tree(p, from, bits) {
    let m = 1;
    for (let i = 0; i < bits; i++) m = (m << 1) | bit(p, from + m);
    return m - (1 << bits);
  }
  function reverse(p, from, bits) {
    let m = 1, found = 0;
    for (let i = 0; i < bits; i++) { const b = bit(p, from + m); m = (m << 1) | b; found |= b << i; }
    return found;
  }
  function direct(bits) {
    let found = 0;
    for (let i = 0; i < bits; i++) {
      c[0] >>>= 1;
      const b = c[1] >= c[0] ? 1 : 0;
      if (b) c[1] -= c[0];
      found = (found << 1) | b;
      if (c[0] < 0x1000000) { c[0] <<= 8; c[1] = (c[1] << 8) | packed[c[2]++]; }
    }
    return found;
  }
  const sized = (l) => (!bit(l.choice, 0) ? 2 + tree(l.low, 0, 3) : !bit(l.choice, 1) ? 10 + tree(l.mid, 0, 3) : 18 + tree(l.high, 0, 8));

  let state = 0, rep0 = 0, rep1 = 0, rep2 = 0, rep3 = 0, n = 0;
  for (;;) {
    if (n > length) throw new Error("the packed data are damaged");
    if (!bit(isMatch, state)) {
      const base = 0x300 * (n ? out[n - 1] >> 5 : 0);
      let symbol = 1;
      if (state >= 7) {
        let byte = out[n - rep0 - 1];
        do {
          const first = (byte >> 7) & 1;
          byte <<= 1;
          const b = bit(literal, base + ((1 + first) << 8) + symbol);
          symbol = (symbol << 1) | b;
          if (first !== b) break;
        } while (symbol < 0x100);
      }
      while (symbol < 0x100) symbol = (symbol << 1) | bit(literal, base + symbol);
      out[n++] = symbol;
      state = state < 4 ? 0 : state < 10 ? state - 3 : state - 6;
      continue;
    }
    let size = 0;
    if (!bit(isRep, state)) {
      rep3 = rep2; rep2 = rep1; rep1 = rep0;
      size = sized(matched);
      state = state < 7 ? 7 : 10;
      const slot = tree(slots, 64 * Math.min(size - 2, 3), 6);
      if (slot < 4) rep0 = slot;
      else {
        const bits = (slot >> 1) - 1, base = (2 | (slot & 1)) << bits;
        rep0 = slot < 14 ? base + reverse(special, base - slot, bits) : base + (direct(bits - 4) << 4) + reverse(align, 0, 4);
      }
      if (rep0 === -1) break;
    } else {
      if (!bit(isRep0, state)) {
        if (!bit(isLong, state)) {
          state = state < 7 ? 9 : 11;
          out[n] = out[n - rep0 - 1];
          n++;
          continue;
        }
      } else {
        let distance = 0;
        if (!bit(isRep1, state)) distance = rep1;
        else {
          if (!bit(isRep2, state)) distance = rep2;
          else { distance = rep3; rep3 = rep2; }
          rep2 = rep1;
        }
        rep1 = rep0;
        rep0 = distance;
      }
      size = sized(repeated);
      state = state < 7 ? 8 : 11;
    }
    for (const end = n + size; n < end; n++) out[n] = out[n - rep0 - 1];
  }
  if (n !== length || c[1] !== 0 || c[2] !== packed.length) throw new Error("the packed data are damaged");
  return out;
}
