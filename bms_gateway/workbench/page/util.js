// Small things that all parts of the page use.
export const $ = (id) => document.getElementById(id);

export function el(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name === "style") node.style.cssText = value;
    else if (name === "html") node.innerHTML = value; // only for HTML that the server made of escaped text
    else node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.filter((c) => c !== null && c !== undefined && c !== false));
  return node;
}

// What a reload keeps, of this tab alone.
const KEPT = "workbench";
export const ui = Object.assign(
  { desk: "", tab: "open", record: 0, cell: 0, off: [], closeUp: false, sameColors: false, session: null, open: [], tracks: [], beside: [], by: "start", cursors: null, measuring: false, pair: null, uploads: {}, opened: {}, unkept: {} },
  JSON.parse(sessionStorage.getItem(KEPT) || "{}"),
);
export const keep = (change = {}) => {
  Object.assign(ui, change);
  sessionStorage.setItem(KEPT, JSON.stringify(ui));
};

// So many of something, in the number that it has.
export const many = (n, one, several = `${one}s`) => `${n} ${n === 1 ? one : several}`;
// A number to so many decimals, without the sign of a nought.
export const fixed = (x, decimals) => { const text = x.toFixed(decimals); return Number(text) ? text.replace("-", "−") : text.replace("-", ""); };
// A setting, or a difference of settings, to hundredths at most: 47.8 − 50 is −2.2, not −2.200000000000003.
export const plain = (x) => String(Number(x.toFixed(2))).replace("-", "−");
// A sentence begins with a capital letter; what begins with a name, such as that of a file, stays as it is.
export const sentence = (text) => (/^[a-z]+[ ,:;] ?[^/]/.test(text ?? "") && !/^[a-z]+:\S/.test(text) ? text[0].toUpperCase() + text.slice(1) : text);

function say(text) {
  const told = sentence(text || "");
  $("error").hidden = !text;
  if ($("error-text").textContent !== told) $("error-text").textContent = told;
}

// What went wrong with a wish stays until the next wish; the desk takes back only what it has said itself.
let ofDesk = "", during = "";
export function complain(text, busy = "") {
  ofDesk = "";
  during = busy;
  say(text);
}
// That something else ran, by its title, is true only while it runs.
export const runs = (title) => { if (during && during !== title) complain(""); };
export const answers = () => { if ($("error-text").textContent === sentence(LOST)) complain(""); };
export function fault(text) {
  if (text ? text !== ofDesk : ofDesk) say(text);
  ofDesk = text;
}

async function answered(response) {
  let document = null;
  try { document = await response.json(); } catch { /* told below */ }
  if (response.ok && document) return document;
  throw Object.assign(new Error(document?.error || `the workbench answered ${response.status}`), { busy: document?.busy });
}

export const LOST = "the workbench does not answer: is the program still running?";
async function asked(url, how) {
  let response;
  try { response = await fetch(url, how); } catch {
    dispatchEvent(new Event("lost")); // main.js looks for the program until it answers
    throw Object.assign(new Error(LOST), { lost: true });
  }
  return answered(response);
}

// How much of what a person asked for is still under way, for those who wait until the page has come to rest.
let underway = 0;
export const until = async (work) => {
  document.body.dataset.underway = ++underway;
  try { return await work(); } finally { document.body.dataset.underway = --underway; }
};

// What is done a moment after the last wish of several; it is under way from the first wish on.
export function afterwards(ms, work) {
  let newest = 0;
  return () => until(async () => {
    const mine = ++newest;
    await new Promise((done) => setTimeout(done, ms));
    if (mine === newest) await work();
  });
}

// What a person does before this tab has its desk waits for it.
let claimed = null;
export const desked = new Promise((done) => { claimed = done; });
export const claim = () => claimed();
const AT_ONCE = ["desk", "resume"]; // asked for on the way to a desk

export const get = (what, query = {}) => asked(`/api/${what}?${new URLSearchParams({ desk: ui.desk, ...query })}`);
export const post = (what, body = {}) => until(async () => {
  if (!AT_ONCE.includes(what)) await desked;
  return asked(`/api/${what}?${new URLSearchParams({ desk: ui.desk })}`, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  });
});
// On the way to a desk files are sent to it before anything else may come.
export const upload = async (file, early = false) => {
  if (!early) await desked;
  return asked(`/api/upload?${new URLSearchParams({ desk: ui.desk, name: file.name })}`, {
    method: "POST", headers: { "Content-Type": "application/octet-stream" }, body: file,
  });
};

// Runs what a person asked for; what goes wrong becomes one line on the page.
export const attempt = (work) => async (...words) => {
  try {
    complain("");
    await until(() => work(...words));
  } catch (e) {
    complain(e.message, e.busy);
    if (e.busy) dispatchEvent(new Event("busy")); // it may have ended meanwhile
  }
};

export const K = (x, digits = 3) => (x === null || x === undefined ? "–" : x === 0 ? "0 K" : `${amount(x, digits)} K`);
export function amount(x, digits = 3) {
  const rounded = Math.abs(Number(x.toPrecision(digits))); // 0.09996 is 0.100, not 0.1000
  const size = rounded ? Math.floor(Math.log10(rounded)) : 0;
  return fixed(x, Math.min(Math.max(digits - 1 - size, 0), 6));
}

// A time of the live page, in s since its beginning: that of the wall where the frames have it, with its date where it is of another day
// than what stands beside it; otherwise that of the frames' own clock, as in the files.
export const clock = (s) => `${Math.floor(s / 3600)}:${String(Math.floor(s / 60) % 60).padStart(2, "0")}:${String(Math.floor(s % 60)).padStart(2, "0")}`;
// By the beginning of the run, which is the same in every picture: by the moment that is shown, times would waver by a rounding.
export const wallMs = (p, at) => (p.wall_ms === null ? null : 1e3 * (p.first_s + at));
const two = (x) => String(x).padStart(2, "0");
export const moment = (ms, beside = Date.now()) => {
  const [one, other] = [new Date(ms), new Date(beside)], time = [one.getHours(), one.getMinutes(), one.getSeconds()].map(two).join(":");
  return one.toDateString() === other.toDateString() ? time : `${one.getFullYear()}-${two(one.getMonth() + 1)}-${two(one.getDate())} ${time}`;
};
export const when = (p, at, beside) => { const ms = wallMs(p, at); return ms === null ? clock(Math.max(p.first_s + at, 0)) : moment(ms, beside ?? Date.now()); };

// A table that is wider than its place says that it scrolls.
const sizes = new ResizeObserver((all) => all.forEach(({ target }) => target.classList.toggle("more", target.scrollWidth > target.clientWidth + 1)));
export function wide(node) {
  sizes.observe(node);
  if (node.firstElementChild) sizes.observe(node.firstElementChild);
  return node;
}

// Numbers as a list, of which many in a row are told by their ends.
const MANY = 6;
export function counted(cells) {
  const runs = [];
  for (const k of cells) { if (runs.length && runs.at(-1).at(-1) === k - 1) runs.at(-1).push(k); else runs.push([k]); }
  return runs.map((r) => (r.length > MANY ? `${r[0]} to ${r.at(-1)}` : r.join(", "))).join(", ");
}
