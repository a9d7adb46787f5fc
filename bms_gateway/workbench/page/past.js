// The past of one string on the live page: hottest point with its band, limit and alerts; what drove it; export.
import { $, el, post, attempt, ui, clock, complain, counted, fixed, many, until, wallMs, when } from "./util.js";
import { put as keepUpload, opened as uploadsOpened } from "./kept.js";

const SVG = "http://www.w3.org/2000/svg";
const EVERY_MS = 4000;
const LEFT = 62, RIGHT = 12;
// What is drawn: its name, its title, its height in px, and what it is multiplied by (a flow also by the nominal one); of the rest, what is known.
const PANELS = [["hottest", "hottest point, °C", 120, 1], ["current", "current, A", 50, 1], ["inlet", "inlet, °C", 40, 1], ["flow", "flow, l/min", 40, 1], ["soc", "SOC, %", 40, 100], ["voltage", "voltage, V", 40, 1]];
const PER_MIN = 60000; // l/min in a m³/s
const COLORS = { hottest: "var(--after)", inlet: "var(--after)", soc: "var(--good)" };
const HELD = ["current", "flow", "soc"]; // from one tick to the next
const NARROW = 520; // px, below which there is room for two times only
const TOP = 20, GAP = 20, FOOT = 24; // px; the title of a panel stands above it, where no curve is
const SPANS = [[600, "last 10 min"], [3600, "last hour"], [0, "all that is kept"], ["chosen", "stretch from … to …"]];
const DRAGGED_PX = 4; // less is a click
let chosen = null; // start and end of a stretch that a person chose, s on the clock of the frames
let about = null, fleet = "", view = "", seek = null, shown = null, asked = 0, key = "", busy = false;
let miswritten = false, barren = false; // the fields hold what is refused; the stretch that was asked for is refused or empty

export function build(known, name, jump, grafana) {
  about = known; view = name; seek = jump; fleet = grafana;
  const choice = (id, options) => el("select", { id, onchange: (e) => { if (id === "past-span") chosen = e.target.value === "chosen" ? seenEnds() : null; anew(); } }, ...options.map(([v, t]) => el("option", { value: v }, t)));
  const svg = document.createElementNS(SVG, "svg");
  for (const [k, v] of Object.entries({ id: "past", height: 270, width: "100%", role: "img", "aria-label": "Hottest point over time: nothing yet" })) svg.setAttribute(k, v);
  drag(svg);
  const section = el("section", { "aria-label": "Past" }, el("div", { class: "heads" }, el("h3", {}, "Hottest point over time"),
    el("label", { for: "past-string" }, "String "), choice("past-string", about.strings.map((s, i) => [i, s.name])),
    el("label", { for: "past-span" }, "of the "), choice("past-span", SPANS), ...[["from", "from "], ["to", "to "]].map(([k, t]) => el("span", { class: "moment" }, el("label", { for: `past-${k}` }, t),
      el("input", { id: `past-${k}`, autocomplete: "off", spellcheck: "false", onblur: typed, onkeydown: (e) => { if (e.key === "Enter") typed(); } }))),
    el("a", { id: "export", class: "file", download: "estimates.csv" }, "Export its estimates (CSV)"),
    el("a", { id: "export-signals", class: "file", download: "" }, "Export its signals (CSV)"),
    el("button", { type: "button", id: "diagnose-window", onclick: attempt(diagnose) }, "Diagnose this window"),
    el("a", { id: "grafana", class: "file", target: "_blank", rel: "noopener noreferrer", hidden: true }, "This window in Grafana")),
    svg, el("p", { id: "past-unknown", hidden: true }), el("ul", { id: "past-marks" }), el("p", { class: "muted" }, "Band: 95 %. Dashed: limit. Upright lines: alerts raised, orange for warnings, red for alarms. A click goes to that moment; so does a click on an alert of the list, or on a row of the table below. Drag across the picture, or write a start and an end, to choose a stretch: it is what is exported and diagnosed."));
  queueMicrotask(link);
  addEventListener("resize", () => { if (shown && svg.clientWidth) draw(); });
  return section;
}

// What is asked of the server for the stretch that is shown.
const wanted = () => ({ view, span: chosen ? 0 : $("past-span").value, ...(chosen ? { from: chosen[0], to: chosen[1] } : {}) });
// A stretch that is refused is not exported or diagnosed, and no other one in its place.
const link = () => {
  const string = $("past-string").value, off = miswritten || barren;
  const to = { export: `/api/window?${new URLSearchParams(wanted())}`, "export-signals": `/api/signals?${new URLSearchParams({ desk: ui.desk, string, ...wanted() })}` };
  for (const [id, href] of Object.entries(to)) {
    for (const [k, v] of Object.entries(off ? { role: "link", "aria-disabled": "true" } : { href })) $(id).setAttribute(k, v);
    for (const k of off ? ["href"] : ["role", "aria-disabled"]) $(id).removeAttribute(k);
  }
  $("diagnose-window").disabled = off;
  if (off) $("grafana").hidden = true;
};
const anew = () => {
  if (miswritten) complain("");
  miswritten = barren = false;
  asked = 0; key = ""; link();
  if (latest) follow(latest);
};
const seenEnds = () => (shown?.t.length > 1 ? [shown.first_s + shown.t[0], shown.first_s + shown.t.at(-1)] : null);

function choose(from, to) {
  chosen = [from, to];
  $("past-span").value = "chosen";
  anew();
}

// Start and end as a person reads and writes them: local date and time where the frames have the time of the wall, else as their own clock counts.
const dated = () => latest?.wall_ms != null;
const written = (s) => {
  if (!dated()) return clock(s);
  const at = new Date(1e3 * s), two = (x) => String(x).padStart(2, "0");
  return `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())} ${[at.getHours(), at.getMinutes(), at.getSeconds()].map(two).join(":")}`;
};
// A date that the calendar has and a time, in the one form of this page whatever the browser's language; without its date, of the day that `beside` has.
const DATED = /^(?:(\d{4})-(\d{1,2})-(\d{1,2})[ T]+)?(\d{1,2}):(\d\d)(?::(\d\d)([.,]\d+)?)?$/;
function local(text, beside) {
  const found = DATED.exec(text.trim()), [day] = beside.split(" ");
  if (!found) return NaN;
  const [year, month, date] = found[1] ? found.slice(1, 4).map(Number) : day.split("-").map(Number), [hour, minute, second] = found.slice(4, 7).map((x) => Number(x ?? 0));
  const at = new Date(year, month - 1, date, hour, minute, second);
  return at.getMonth() === month - 1 && at.getDate() === date && hour < 24 && minute < 60 && second < 60 ? at / 1e3 + Number((found[7] ?? "0").replace(",", ".")) : NaN;
}
function moment(text, beside) {
  if (dated()) return local(text, beside);
  const parts = text.trim().split(":").map((x) => (/^\d+([.,]\d+)?$/.test(x) ? Number(x.replace(",", ".")) : NaN));
  return parts.length <= 3 ? parts.reduce((all, x) => 60 * all + x, 0) : NaN;
}

function fields() {
  if (miswritten) return; // what was written stays until it is put right, or another stretch is chosen
  for (const [k, s] of Object.entries({ from: ends()[0], to: ends()[1] })) {
    const field = $(`past-${k}`);
    if (document.activeElement === field) continue;
    field.placeholder = dated() ? "2026-03-01 14:05:00" : "0:12:30";
    field.classList.toggle("dated", dated());
    field.value = field.dataset.told = written(shown.first_s + s);
    field.dataset.s = shown.first_s + s; // seconds are written whole
  }
}

function typed() {
  const both = ["from", "to"].map((k) => $(`past-${k}`));
  if (both.some((f) => f.dataset.told === undefined)) return; // nothing was heard yet
  if (both.every((f) => f.value === f.dataset.told)) {
    if (miswritten) { miswritten = false; complain(""); link(); toFleet(); }
    return;
  }
  const [from, to] = both.map((f) => (f.value === f.dataset.told ? Number(f.dataset.s) : moment(f.value, f.dataset.told)));
  const why = Number.isNaN(from) || Number.isNaN(to) ? (dated() ? "a date and a time such as 2026-03-01 14:05:00 are needed" : "a time such as 0:12:30 is needed") : from >= to ? "the end of the stretch must be after its start" : "";
  miswritten = why !== "";
  complain(why);
  if (miswritten) link();
  else {
    both.forEach((f, k) => { f.dataset.told = f.value; f.dataset.s = [from, to][k]; });
    choose(from, to);
  }
}

// A click goes to a moment; who drags chooses a stretch.
function drag(svg) {
  let began = null, rect = null;
  const time = (e) => {
    const box = svg.getBoundingClientRect(), [t0, t1] = ends();
    return Math.min(Math.max(t0 + ((e.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT)) * (t1 - t0), t0), t1);
  };
  svg.addEventListener("pointerdown", (e) => { if (shown?.t.length && e.button === 0) { began = e.clientX; svg.setPointerCapture(e.pointerId); } });
  svg.addEventListener("pointermove", (e) => {
    if (began === null || Math.abs(e.clientX - began) < DRAGGED_PX) return;
    const left = svg.getBoundingClientRect().left, [a, b] = [began, e.clientX].sort((p, q) => p - q);
    rect ??= document.createElementNS(SVG, "rect");
    for (const [k, v] of Object.entries({ class: "choice", x: a - left, width: b - a, y: TOP, height: Number(svg.getAttribute("height")) - TOP - FOOT, fill: "var(--accent)", "fill-opacity": 0.25 })) rect.setAttribute(k, v);
    svg.append(rect);
  });
  svg.addEventListener("pointerup", (e) => {
    if (began === null) return;
    const [from, to] = [time({ clientX: began }), time(e)].sort((p, q) => p - q);
    if (rect) choose(shown.first_s + from, shown.first_s + to);
    else seek(to);
    rect?.remove();
    began = rect = null;
  });
  svg.addEventListener("pointercancel", () => { rect?.remove(); began = rect = null; });
}

// The fleet's dashboard with the same string and window; only where the frames have the time of the wall.
function toFleet() {
  const known = fleet && latest?.wall_ms != null && shown.t.length > 1 && !miswritten && !barren;
  $("grafana").hidden = !known;
  if (!known) return;
  const ms = (t) => Math.round(wallMs(latest, t)), to = new URL(fleet);
  for (const [k, v] of [["from", ms(shown.t[0])], ["to", ms(shown.t.at(-1))], ["var-string", about.strings[shown.string].name]]) to.searchParams.set(k, v);
  $("grafana").href = to.href;
}

// Opens the signals of the window on this tab's desk: the road begins there, with the model of the live page.
async function diagnose() {
  const { files } = await post("window", { view, string: Number($("past-string").value), span: chosen ? 0 : Number($("past-span").value), ends: chosen });
  until(() => keepBoth(files)).catch((e) => complain(e.message));
  dispatchEvent(new CustomEvent("tab", { detail: "compare" }));
}

// As uploads are: the program may have forgotten this window when it is started anew.
async function keepBoth(files) {
  for (const name of files) {
    const answer = await fetch(`/api/take?${new URLSearchParams({ desk: ui.desk, what: "file", name })}`);
    if (answer.ok) await keepUpload(await answer.blob(), name);
  }
  uploadsOpened();
}
const ends = () => [shown.t[0], Math.max(shown.t.at(-1), shown.t[0] + 1)];

// Asks anew now and then while the picture goes on, and soon after another stretch is wanted.
let latest = null, later = 0;
export function follow(p) {
  latest = p;
  const now = `${$("past-string").value}|${$("past-span").value}|${chosen ?? (p.following ? p.ticks : p.at)}`;
  if (busy || now === key) return;
  const wait = asked ? EVERY_MS - (performance.now() - asked) : 0;
  clearTimeout(later);
  if (wait > 0) { later = setTimeout(() => follow(latest), wait); return; }
  key = now; asked = performance.now(); busy = true;
  const string = $("past-string").value, query = new URLSearchParams({ string, ...wanted() });
  let failed = false;
  fetch(`/api/history?${query}`).then((r) => r.json()).then((found) => {
    if (key !== now) return; // another stretch was chosen meanwhile
    if (found.error) { barren = true; link(); complain(found.error); return; }
    shown = { ...found, string: Number(string) }; barren = !shown.t.length; draw(); link(); if (!barren) fields(); toFleet(); $("past").dataset.points = found.t.length;
  })
    .catch((e) => { failed = true; key = ""; complain(e.message); }).finally(() => { busy = false; if (!failed) follow(latest); });
}

function draw() {
  const svg = $("past");
  svg.replaceChildren();
  const put = (tag, more, text = "") => { const n = document.createElementNS(SVG, tag); for (const [k, v] of Object.entries(more)) n.setAttribute(k, v); n.textContent = text; svg.append(n); return n; };
  if (shown.t.length < 2) {
    const said = shown.t.length ? "One estimate only in this stretch" : "No estimates in this stretch";
    put("text", { x: LEFT, y: TOP + 20, fill: "var(--soft)" }, said);
    svg.setAttribute("aria-label", said);
    return;
  }
  const width = Math.max(svg.clientWidth, 200), [t0, t1] = ends(), limit = about.limits.core_C;
  let below = TOP - GAP;
  const panels = PANELS.filter(([name]) => shown[name].some((v) => v !== null)).map(([name, title, height, scale]) => {
    const top = below + GAP;
    below = top + height;
    return [name, title, top, below, name === "flow" ? PER_MIN * about.strings[shown.string].nominal_m3_s : scale];
  });
  svg.setAttribute("height", below + FOOT);
  const x = (t) => LEFT + ((width - LEFT - RIGHT) * (t - t0)) / (t1 - t0);
  for (const [name, title, top, bottom, scale] of panels) {
    // a cell in alarm that is not known may be hotter than all that is: there is no curve then
    const y = shown[name].map((v, i) => (v === null || (name === "hottest" && shown.hidden[i]) ? null : scale * v)), vague = y.map((v, i) => v !== null && name === "hottest" && shown.half[i] > about.available.unknown_95);
    const sure = y.map((v, i) => (vague[i] ? null : v)), scaled = sure.some((v) => v !== null) ? sure : y.some((v) => v !== null) ? y : shown[name].map((v) => v && scale * v), there = scaled.map((v, i) => [i, v]).filter(([, v]) => v !== null);
    const half = (i) => (name === "hottest" ? shown.half[i] ?? 0 : 0);
    let low = Math.min(...there.map(([i, v]) => v - half(i))), high = Math.max(...there.map(([i, v]) => v + half(i)));
    if (name === "hottest" && limit < high + 20) [low, high] = [Math.min(low, limit - 1), Math.max(high, limit + 1)];
    const middle = (low + high) / 2, spread = Math.max(high - low, 1) / 2;
    low = middle - spread; high = middle + spread;
    const at = (v) => bottom - ((bottom - top) * (v - low)) / (high - low);
    put("rect", { x: LEFT, y: top, width: width - LEFT - RIGHT, height: bottom - top, fill: "none", stroke: "var(--line)" });
    put("text", { x: LEFT - 5, y: top + 10, "text-anchor": "end" }, number(high, spread));
    put("text", { x: LEFT - 5, y: bottom, "text-anchor": "end" }, number(low, spread));
    if (name === "hottest") {
      unknown(put, x, top, bottom);
      const inside = (v) => Math.min(Math.max(at(v), top), bottom), edge = (sign, run) => run.map((i) => `${x(shown.t[i]).toFixed(1)},${inside(y[i] + sign * half(i)).toFixed(1)}`);
      const wide = y.map((v, i) => (vague[i] ? v : null)); // not known to 12 K (1 sd): no line, and a band that looks like no result
      for (const run of runs(wide)) put("polygon", { points: [...edge(1, run), ...edge(-1, run).reverse()].join(" "), fill: "var(--soft)", "fill-opacity": 0.12, stroke: "var(--soft)", "stroke-dasharray": "2 4", class: "vague" });
      for (const run of runs(sure)) put("polygon", { points: [...edge(1, run), ...edge(-1, run).reverse()].join(" "), fill: "var(--after)", "fill-opacity": 0.2 }); // a gap stays open
      if (limit <= high) put("line", { x1: LEFT, x2: width - RIGHT, y1: at(limit), y2: at(limit), stroke: "var(--danger)", "stroke-dasharray": "6 4", class: "limit" });
    }
    const point = (i, v) => `${x(shown.t[i]).toFixed(1)},${at(v).toFixed(1)}`;
    // of all cells in full, of those that are known alone dashed
    const lines = name === "hottest" ? [[sure.map((v, i) => (shown.unknown[i] ? null : v)), {}], [sure.map((v, i) => (shown.unknown[i] ? v : null)), { "stroke-dasharray": "5 3", class: "line-others" }]] : [[sure, {}]];
    for (const [line, more] of lines) for (const run of runs(line)) put("polyline", { points: run.flatMap((i, k) => [...(k && HELD.includes(name) ? [point(i, y[i - 1])] : []), point(i, y[i])]).join(" "), class: `line-${name}`, fill: "none", stroke: COLORS[name] ?? "var(--ink)", "stroke-width": name === "hottest" ? 2 : 1.2, ...more });
    put("text", { x: LEFT, y: top - 5, fill: "var(--soft)", class: "title" }, vague.includes(true) ? `${title}${width < NARROW ? " (grey: not known)" : ` (grey, without a line: not known to ${about.available.K} K)`}` : title);
  }
  for (const m of shown.marks.filter((k) => k.state !== "over")) {
    put("line", { x1: x(m.at), x2: x(m.at), y1: TOP, y2: below, stroke: m.level === "alarm" ? "var(--danger)" : "var(--before)", "stroke-width": 2, class: `mark ${m.level}` });
  }
  marks();
  const bottom = below + 18;
  const times = width < NARROW ? [t0, t1] : [t0, (t0 + t1) / 2, t1]; // the date, where it is not today, stands once
  times.forEach((t, i) => put("text", { x: x(t), y: bottom, "text-anchor": t === t0 ? "start" : t === t1 ? "end" : "middle", class: "time" }, when(latest, t, i ? wallMs(latest, times[i - 1]) : null)));
  const hot = shown.hottest.filter((v, i) => v !== null && !shown.unknown[i] && !(shown.half[i] > about.available.unknown_95)), lost = sayUnknown();
  svg.setAttribute("aria-label", `Hottest point of ${about.strings[shown.string].name} from ${when(latest, t0)} to ${when(latest, t1)}: ${hot.length ? `${Math.min(...hot).toFixed(1)} to ${Math.max(...hot).toFixed(1)} °C` : "not known"}${lost ? `. ${lost} L` : ", l"}imit ${limit} °C, ${many(shown.marks.length, "change of an alert", "changes of alerts")}`);
}

// Stretches in which the hottest point of all cells is not known: hatched, and red where a cell in alarm is not known.
function unknown(put, x, top, bottom) {
  const { t } = shown, side = (id, turn, color) => {
    const p = put("pattern", { id, width: 7, height: 7, patternUnits: "userSpaceOnUse", patternTransform: `rotate(${turn})` }), line = document.createElementNS(SVG, "rect");
    for (const [k, v] of Object.entries({ width: 1.6, height: 7, fill: color })) line.setAttribute(k, v);
    p.append(line);
  };
  side("past-dark", 45, "var(--soft)");
  side("past-burning", -45, "var(--danger)");
  for (const [id, there] of [["past-dark", (i) => shown.unknown[i] && !shown.hidden[i]], ["past-burning", (i) => shown.hidden[i]]]) {
    for (const run of runs(t.map((_, i) => (there(i) ? 1 : null)))) {
      const from = x(t[run[0]]), to = x(t[Math.min(run.at(-1) + 1, t.length - 1)]);
      put("rect", { x: from, y: top, width: Math.max(to - from, 1), height: bottom - top, fill: `url(#${id})`, "fill-opacity": 0.55, class: id === "past-dark" ? "unknown" : "unknown burning" });
    }
  }
}

// The same in words.
function sayUnknown() {
  const { dark, burning, share } = shown, box = $("past-unknown"), cells = (some) => `${some.length > 1 ? "cells" : "cell"} ${counted(some)}`;
  const percent = share > 0.995 ? "all" : `${share < 0.01 ? "under 1" : (100 * share).toFixed(0)} %`;
  const said = dark.length ? `Hatched: in ${percent} of this stretch the hottest point of all is not known, because ${cells(dark)} ${dark.length > 1 ? "were" : "was"} not known at some time; the dashed curve is the hottest of those that were known.` : "";
  const red = burning.length ? ` Red: ${cells(burning)} ${burning.length > 1 ? "were" : "was"} in alarm and not known, so there is no curve.` : "";
  box.hidden = !said;
  box.className = burning.length ? "danger" : "alarm";
  if (box.textContent !== said + red) box.textContent = said + red;
  return said + red;
}

// The alerts that the upright lines stand for, in words, the newest first; a button goes to its moment.
const MOST_MARKS = 8;
function marks() {
  const raised = shown.marks.filter((k) => k.state !== "over").reverse(), told = JSON.stringify(raised), list = $("past-marks");
  if (list.dataset.told === told) return;
  list.dataset.told = told;
  list.replaceChildren(...raised.slice(0, MOST_MARKS).map((m) => el("li", { class: m.level }, el("button", { type: "button", onclick: () => seek(m.at) }, when(latest, m.at)), ` ${m.level === "alarm" ? "Alarm" : "Warning"}: ${m.text}`)),
    ...(raised.length > MOST_MARKS ? [el("li", {}, `and ${raised.length - MOST_MARKS} earlier, see below`)] : []));
}

const number = (v, spread) => fixed(v, spread < 5 ? 1 : 0);

// Stretches of indices without a gap.
function runs(y) {
  const found = [[]];
  y.forEach((v, i) => { if (v === null) { if (found.at(-1).length) found.push([]); } else found.at(-1).push(i); });
  return found.filter((r) => r.length);
}
