// Contours of two parameters: where a fit leaves them, where they were known to be before, and how they hang together.
import { $, el, ui, keep, amount, fixed } from "./util.js";

const RADII = { 95: 2.4477, 68: 1.5096 }; // sd of a Gaussian of two numbers within which that share of it lies
const POINTS = 121;
const LEAST = 0.02; // of a number: a contour that is much narrower would fill the axis with nothing
const GREY = "#777777";

const value = (n, z) => n.scale * (n.log ? Math.exp(z) : z);
const place = (known, key) => known.numbers.findIndex((n) => n.key === key);
const knownOf = (s) => s.variant?.known ?? null;
const title = (n) => `${n.name}${n.unit ? `, ${n.unit}` : ""}`;

// The contour of two coordinates with these variances and covariance, as numbers.
function ellipse([a, b], [at, bt], [vaa, vab, vbb], radius) {
  const la = Math.sqrt(vaa), lb = vab / la, lc = Math.sqrt(Math.max(vbb - lb * lb, 0)), x = [], y = [];
  for (let k = 0; k < POINTS; k++) {
    const angle = (2 * Math.PI * k) / (POINTS - 1), u = radius * Math.cos(angle), v = radius * Math.sin(angle);
    x.push(value(a, at + la * u));
    y.push(value(b, bt + lb * u + lc * v));
  }
  return { x, y };
}

// What one fit says of two of its numbers; null where it has not both.
function both(known, [p, q]) {
  const i = place(known, p), j = place(known, q);
  if (i < 0 || j < 0) return null;
  const [a, b] = [known.numbers[i], known.numbers[j]], of = known.covariance, v = [of[i][i], of[i][j], of[j][j]];
  return { a, b, v, at: [a.at, b.at], r: v[1] / Math.sqrt(v[0] * v[2]) };
}

function closest(known) {
  let best = [0, 1], most = -1;
  known.numbers.forEach((_, j) => known.numbers.slice(0, j).forEach((__, i) => {
    const r = Math.abs(both(known, [known.numbers[i].key, known.numbers[j].key]).r);
    if (r > most) [best, most] = [[i, j], r];
  }));
  return best.map((i) => known.numbers[i].key);
}

const within = (n, z, sd) => `${amount(value(n, z))} (${amount(value(n, z - 1.96 * sd))} to ${amount(value(n, z + 1.96 * sd))})${n.unit ? ` ${n.unit}` : ""}`.replaceAll("-", "−");

function chooser(id, known, chosen, change) {
  const told = JSON.stringify([known.numbers.map((n) => n.key), chosen]), select = $(id);
  select.onchange = () => change(select.value);
  if (select.dataset.told === told) return;
  select.dataset.told = told;
  select.replaceChildren(...known.numbers.map((n) => el("option", { value: n.key, selected: n.key === chosen }, n.name)));
}

// The picture of the two that are chosen, for the steps that are ticked; null where no fit has two numbers.
// The axes hold the contours of all steps, whichever are ticked.
export function picture(steps, ticked, styleOf, again) {
  const fitted = ticked.filter((s) => knownOf(s)?.numbers.length > 1), top = fitted.at(-1);
  $("pairs").hidden = !top;
  if (!top) return null;
  const known = knownOf(top), there = (ui.pair ?? []).every((k) => place(known, k) >= 0) && ui.pair?.[0] !== ui.pair?.[1];
  const pair = there && ui.pair ? ui.pair : closest(known);
  // who takes for one what is the other has them change places
  ["pair-x", "pair-y"].forEach((id, k) => chooser(id, known, pair[k], (key) => {
    const next = [...pair];
    if (next[1 - k] === key) next[1 - k] = pair[k];
    next[k] = key;
    keep({ pair: next });
    again();
  }));
  const main = both(known, pair), { a, b } = main, data = [], ends = [[], []];
  for (const s of steps) {
    const own = knownOf(s) && both(knownOf(s), pair);
    if (!own) continue;
    const wide = ellipse([own.a, own.b], own.at, own.v, RADII[95]), [color, dash] = styleOf(s), full = s === top;
    ends[0].push(...wide.x); ends[1].push(...wide.y);
    if (!fitted.includes(s)) continue;
    const line = { type: "scatter", mode: "lines", name: s.name, legendgroup: s.name, opacity: full ? 1 : 0.6, line: { color, dash, width: full ? 2.4 : 1.4 }, hoverinfo: "skip" };
    data.push({ ...line, ...wide });
    if (full) data.push({ ...line, ...ellipse([own.a, own.b], own.at, own.v, RADII[68]), showlegend: false, line: { ...line.line, width: 1.2 } });
    data.push({ type: "scatter", mode: "markers", name: s.name, legendgroup: s.name, showlegend: false, x: [value(own.a, own.at[0])], y: [value(own.b, own.at[1])], marker: { color, size: full ? 8 : 6, symbol: s.core?.proven === false ? "circle-open" : "circle" },
      hovertemplate: "%{x:.4g}, %{y:.4g}" });
  }
  const before = [a, b].map((n) => n.before);
  data.unshift({ type: "scatter", mode: "lines", name: "known before", ...ellipse([a, b], before.map((x) => x[0]), [before[0][1] ** 2, 0, before[1][1] ** 2], RADII[95]), line: { color: GREY, dash: "dot", width: 1.4 }, hoverinfo: "skip" });
  const axis = (n, k) => {
    const low = Math.min(...ends[k]), high = Math.max(...ends[k]), middle = (low + high) / 2, half = Math.max(0.65 * (high - low), LEAST * Math.abs(middle));
    return { title: { text: k ? title(n).replace(" (", "<br>(") : title(n), standoff: 6 }, range: [middle - half, middle + half], gridcolor: "#e3e3e3", zeroline: false, linecolor: "#777777", showline: true, ticks: "outside", nticks: 6 };
  };
  $("pair-told").textContent = `${top.name}: ${a.name} ${within(a, a.at, Math.sqrt(main.v[0]))}; ${b.name} ${within(b, b.at, Math.sqrt(main.v[2]))}; correlation ${fixed(main.r, 2)}${Math.abs(main.r) > 0.9 ? ": hardly known apart" : ""}. In brackets 95 %. Known before: ${within(a, ...before[0])}, ${within(b, ...before[1])}. ${known.wider}`;
  return { data, pair, layout: { height: 340, margin: { l: 84, r: 14, t: 34, b: 48 }, font: { family: "system-ui, Segoe UI, Liberation Sans, Arial, sans-serif", size: 12, color: "#1a1a1a" }, paper_bgcolor: "#ffffff", plot_bgcolor: "#ffffff",
    hovermode: "closest", legend: { orientation: "h", x: 0, y: 1.01, xanchor: "left", yanchor: "bottom" }, xaxis: axis(a, 0), yaxis: axis(b, 1) } };
}
