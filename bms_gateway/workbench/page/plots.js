// The stage: string drawing, plots of the chosen cell with linked time axes, curves of an effect laid over them.
import { $, el, get, ui, keep, K, amount, complain, until, afterwards, wide } from "./util.js";
import { sketch } from "./sketch.js";
import * as measure from "./measure.js";
import * as tracks from "./tracks.js";
import { picture } from "./pairs.js";

const CONFIG = { displaylogo: false, responsive: true,
  modeBarButtons: [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"]] };
const DARK = { "#ffffff": "#16181b", "#1a1a1a": "#e8e8e8", "#000000": "#f2f2f2", "#4d4d4d": "#d0d0d0", "#e3e3e3": "#33373c",
  "#777777": "#9a9a9a", "#0072b2": "#6cb8ea", "#d55e00": "#ff9248", "rgba(0,0,0,0.075)": "rgba(255,255,255,0.09)",
  "#009e73": "#54c9a4", "#cc79a7": "#e3a0c6" };
const TIMED = ["surface", "drive", "core", "map"], LEFT = ["auto", "noise", "heat", "inlet"];
const timed = () => [...TIMED, ...tracks.shown()];
const places = () => [...timed(), ...LEFT];
const NARROW = 600, BUTTONS = 14; // px, below which a plot has no room for buttons, and height of their row
// Blue below, orange above; small values get colour sooner than large ones.
const rgb = (color) => [1, 3, 5].map((i) => parseInt(color.slice(i, i + 2), 16));
const between = (a, b, share) => `rgb(${rgb(a).map((x, i) => Math.round(x + (rgb(b)[i] - x) * share)).join()})`;
const DIVERGING = (middle) => [-4, -3, -2, -1, 0, 1, 2, 3, 4].map((k) => [0.5 + (Math.sign(k) * k * k) / 32, between(middle, k < 0 ? "#0072b2" : "#d55e00", Math.abs(k) / 4)]);
let state = null;
let specs = {};
let curves = new Map();
let over = null; // effect whose curves are shown
let newest = 0; // drawing of all places
let range = ui.zoom ?? null; // zoomed time, of the record
const zoomTo = (next) => { range = next; keep({ zoom: next }); };
// A stretch has the largest unit that it holds; all of a record has that of its figures, in which windows and cursors are kept.
const SECONDS = { s: 1, min: 60, h: 3600 }, ROUNDED = 0.999; // of a unit: a minute that was dragged is a minute
function shownIn(figure) {
  const own = figure.layout.xaxis.title.text.split(", ").at(-1), span = range ? (range[1] - range[0]) * SECONDS[own] : Infinity;
  const unit = ["h", "min"].find((u) => span >= ROUNDED * SECONDS[u]) ?? "s", kept = SECONDS[unit] < SECONDS[own] ? unit : own;
  return { unit: kept, per: SECONDS[own] / SECONDS[kept] };
}
const perOf = (node) => Number(node.dataset.per || 1); // of a plot's axis, units that it shows in one that is kept
const times = (shapes, per) => (per === 1 ? shapes : shapes.map((s) => (s.xref === "x" ? { ...s, x0: s.x0 * per, x1: s.x1 * per } : s)));

// Drawing that a person asked for: the page rests when it is done.
const drawing = (work) => until(work).catch((e) => complain(e.message));
const anew = () => drawing(() => show(state));

// The plots' script runs for a second, in which nothing else is drawn: it comes after the first picture, or while idle.
let loading = null;
const plotly = () => (loading ??= new Promise((done, failed) => {
  document.head.append(el("script", { src: "/plotly.js", onload: done, onerror: () => { loading = null; failed(new Error("the plots' script did not come: reload the page")); } }));
}));
const painted = () => new Promise((done) => {
  if (document.hidden) done();
  else requestAnimationFrame(() => setTimeout(done));
});

export const dark = () => document.documentElement.dataset.theme === "dark";

function themed(x) {
  if (!dark()) return x;
  if (typeof x === "string") return DARK[x] ?? x;
  if (Array.isArray(x)) return typeof x[0] === "number" || x[0] === null ? x : x.map(themed);
  if (x && typeof x === "object") return Object.fromEntries(Object.entries(x).map(([k, v]) => [k, themed(v)]));
  return x;
}

const seen = () => {
  const page = document.documentElement.dataset;
  page.firstPicture ??= Math.round(performance.now());
};

// Colour and line of each step by its place on the road: they stay the same whichever steps are shown.
const STYLES = [["#d55e00", "dash"], ["#0072b2", "solid"], ["#009e73", "solid"], ["#cc79a7", "dashdot"], ["#e69f00", "solid"], ["#56b4e9", "dash"]];
const DASHES = ["solid", "dash", "dashdot", "dot"]; // with the colours, enough for the most steps that a session has
const styleOf = (i) => {
  const [color, dash] = STYLES[i % STYLES.length];
  return [color, DASHES[(DASHES.indexOf(dash) + Math.floor(i / STYLES.length)) % DASHES.length]];
};
export const colorOf = (i) => themed(styleOf(i)[0]);
const faint = (color, share) => `rgba(${rgb(color).join()},${share})`;

// Steps that are ticked; the newest of them is drawn in full, with its band, the others as ghosts.
export const ticked = (all) => { const on = all.filter((s) => !ui.off.includes(s.name)); return on.length ? on : all.slice(-1); };

// The outline of a band, one closed piece for each stretch without a hole: between two lines with holes plotly fills wedges.
function ribbon(low, high) {
  const x = [], y = [], known = (v) => v !== null && v !== undefined && !Number.isNaN(v);
  let first = 0;
  for (let i = 0; i <= low.x.length; i += 1) {
    if (i < low.x.length && known(low.y[i]) && known(high.y[i])) continue;
    for (let k = first; k < i; k += 1) { x.push(low.x[k]); y.push(low.y[k]); }
    for (let k = i - 1; k >= first; k -= 1) { x.push(high.x[k]); y.push(high.y[k]); }
    if (i > first) { x.push(null); y.push(null); }
    first = i + 1;
  }
  return { x, y };
}

function ofSteps(figure, place) {
  const order = state.steps.map((s) => s.name), names = ticked(state.steps).map((s) => s.name);
  const top = names.at(-1), found = [];
  if (place === "map") return (figure.steps ?? []).filter((s) => s.name === top).map((s) => ({ type: "heatmap", ...s.map, coloraxis: "coloraxis", hovertemplate: "cell %{y}, %{x}: %{z} K<extra></extra>" }));
  for (const s of (figure.steps ?? []).filter((x) => names.includes(x.name))) {
    const [color, dash] = styleOf(order.indexOf(s.name)), ghost = s.name !== top;
    const line = (of, width, more = {}) => ({ type: "scatter", mode: "lines", ...of, name: s.name, legendgroup: s.name, opacity: ghost ? 0.75 : 1, ...more, line: { color, dash: more.dash ?? dash, width, shape: of.shape ?? "linear" } });
    const silent = { showlegend: false, hoverinfo: "skip" };
    if (s.low && (!ghost || place === "core")) {
      const fill = faint(color, ghost ? 0.08 : 0.16);
      const hatched = place === "core" && !s.proven ? { fillpattern: { shape: "/", size: 8, solidity: 0.25, fgcolor: faint(color, 0.55), bgcolor: fill } } : { fillcolor: fill };
      found.push({ ...line(ribbon(s.low, s.high), 0, { ...silent, showlegend: !s.model, fill: "toself", ...hatched }), mode: "none" });
    }
    if (s.each && !ghost) found.push(line(s.each, 0.7, { ...silent, yaxis: "y2", opacity: 0.4, dash: "solid" }));
    if (s.mean) found.push(line(s.mean, ghost ? 1.6 : 2.6, { ...silent, yaxis: "y2" }));
    if (s.model) found.push(line(s.model, ghost ? 1.4 : 2)); // of a core that is not known there is none
    if (s.outside && !ghost) found.push({ ...line(s.outside, 3.2, { dash: "solid", opacity: 1 }), name: "thermocouple outside the band", legendgroup: "", line: { color: "#b00020", width: 3.2 } });
  }
  return found;
}

// A long name in as many lines as it takes in a plot of this width, broken between words alone.
const LINE = 16, BETWEEN = 13; // px, of a line of a legend, and between its rows
const LETTER = 6.7, SIGN = 60; // px, of a letter of a legend, and of the line before it with the edges
function lines(text, width) {
  const most = Math.max(Math.floor(width / LETTER), 16), found = [""];
  for (const word of text.split(" ").flatMap((w) => (w.length > most ? w.match(new RegExp(`.{1,${most}}`, "g")) : [w]))) {
    if (found.at(-1) && found.at(-1).length + 1 + word.length > most) found.push(word);
    else found[found.length - 1] += (found.at(-1) ? " " : "") + word;
  }
  return found;
}
// The curves with such names; the legend gets the room that it takes, and no curve is pressed together.
function wrapped(traces, node, layout) {
  const width = node.clientWidth - layout.margin.l - layout.margin.r - SIGN, rows = new Map();
  const found = traces.map((t) => {
    if (!t.name || t.name.length * LETTER <= width) return t;
    const parts = lines(t.name, width);
    if (t.showlegend !== false && t.type !== "heatmap") rows.set(t.name, parts.length);
    return { ...t, name: parts.join("<br>") };
  });
  const more = layout.showlegend === false ? 0 : [...rows.values()].reduce((sum, n) => sum + LINE * n + BETWEEN, 0);
  Object.assign(layout, { margin: { ...layout.margin, t: layout.margin.t + more }, height: layout.height + more });
  return found;
}

const labelled = (name) => state.diagnosed?.ranking.find((r) => r.name === name)?.effects.map((e) => `${e.title} (${e.key})`).join(" and ") || name;

function laidOver(place) {
  if (place === "surface" && fitting?.of === specs.surface?.name) {
    const line = { type: "scatter", mode: "lines", name: `${fitting.step}, being fitted`, hoverinfo: "skip", line: { color: colorOf(state.steps.length), width: 2.6 } };
    return [{ ...line, x: fitting.x, y: fitting.y }, { ...line, x: fitting.at, y: fitting.residual, yaxis: "y2", showlegend: false }];
  }
  const own = over && place === "surface" ? curves.get(over)?.[specs.surface?.name] : null;
  if (!own) return [];
  const line = { type: "scatter", mode: "lines", name: `with ${labelled(over)}`, hoverinfo: "skip" };
  const color = dark() ? "#54c9a4" : "#009e73";
  return [
    { ...line, x: own.x, y: own.y, line: { color, width: 2.6 } },
    { ...line, x: own.at, y: own.residual, yaxis: "y2", showlegend: false, line: { color, width: 2.6 } },
  ];
}

// The model that is being fitted, as it is so far: its curves move while its error falls.
let fitting = null, pictured = 0, asking = false, latest = null;
export const trying = (trial) => until(() => moved(trial));
async function moved(trial) {
  latest = trial ?? null;
  if (!latest) { pictured = 0; if (fitting) { fitting = null; if (specs.surface?.figure && window.Plotly) await draw("surface"); } return; }
  if (asking) return;
  asking = true;
  try {
    while (latest && latest.picture !== pictured && specs.surface?.figure && window.Plotly) {
      pictured = latest.picture;
      const { step } = latest, of = specs.surface.name, { curves: own } = await get("curves", { name: of, fitting: 1 });
      if (latest && own) { fitting = { ...own, of, step }; await draw("surface"); }
    }
  } catch (e) { complain(e.message); } finally { asking = false; }
}

async function draw(place) {
  const node = $(`plot-${place}`);
  const spec = specs[place];
  if (LEFT.includes(place) && !$("leftover").open) return;
  node.parentElement.hidden = !spec?.figure;
  if (!spec?.figure) return;
  const figure = themed(spec.figure);
  const layout = structuredClone(figure.layout);
  const overTime = timed().includes(place);
  if (overTime) {
    layout.xaxis.range = range ?? whole() ?? layout.xaxis.range;
    spec.drawn = layout.xaxis.range.join();
    layout.shapes = [...(layout.shapes ?? []), ...themed(measure.lines())];
  }
  // names of additions are long: the buttons of the plot get a row of their own above them
  if (["surface", "core"].includes(place) && innerWidth > NARROW) {
    layout.margin = { ...layout.margin, t: layout.margin.t + BUTTONS };
    layout.height += BUTTONS;
  }
  // a stretch fills the picture, with the same axes for all steps; records that are laid over it keep those of the whole
  if (range && ["surface", "core"].includes(place) && !figure.beside) Object.assign(layout, axesWithin(figure, layout, range));
  if (place === "surface" && ui.closeUp && !range) layout.yaxis2.range = reach(figure) ?? layout.yaxis2.range;
  layout.uirevision = `${ui.record}`;
  // what was measured lies on top: a model that fits would hide it
  const measured = figure.data.filter((t) => t.name === "measured" && !t.yaxis);
  const over = figure.data.filter((t) => t.name === "thermocouple in the core");
  const data = [...figure.data.filter((t) => !measured.includes(t) && !over.includes(t)), ...over, ...themed(ofSteps(figure, place)), ...laidOver(place), ...tracks.curves(spec.figure, dark(), ticked(state.steps).at(-1)?.name), ...measured.map((t) => ({ ...t, legendrank: 1 }))];
  if (place === "map") {
    const own = figure.steps?.find((s) => s.name === ticked(state.steps).at(-1).name)?.span?.coloraxis;
    const [low, high] = (!ui.sameColors && own) || layout.coloraxis.range;
    const ends = [low, 0, high], bar = { ...layout.coloraxis.colorbar, tickvals: ends, ticktext: ends.map((x) => (x ? `${x > 0 ? "+" : ""}${amount(x, 2)}` : "0")) };
    layout.coloraxis = { ...layout.coloraxis, colorbar: bar, cmin: low, cmax: high, colorscale: DIVERGING(dark() ? "#16181b" : "#ffffff") };
    $("map-title").textContent = `Residual of all sensors, K: ${ticked(state.steps).at(-1).name}`;
  }
  if (place === "core") unknown(layout, 0.9 * (node.clientWidth - layout.margin.l - layout.margin.r));
  if (place === "noise") beyond(layout, figure);
  const shown = wrapped(overTime ? timesOf(data, layout, figure, node) : data, node, layout);
  node.style.height = `${layout.height}px`;
  node.setAttribute("role", "group");
  node.setAttribute("aria-label", { surface: `Surface temperature of cell ${ui.cell}, measured and modelled, over time; below it the residual`,
    drive: "What drove the string: current, coolant inlet and what else is known, over time",
    core: `Core temperature of cell ${ui.cell} over time with its 95 percent band`,
    map: "Reading minus model of all sensors over time, as a map; a click shows a cell",
    auto: `Autocorrelation of the residual of cell ${ui.cell} with the bounds of white noise`,
    noise: `Histogram of the residual of cell ${ui.cell} against the noise of its sensor`,
    heat: `Correlation of the residual of cell ${ui.cell} with the square of the current`,
    inlet: `Correlation of the residual of cell ${ui.cell} with the inlet` }[place] ?? `${node.dataset.column} of the table over time`);
  if (!window.Plotly) {
    if (place === "surface" && sketch(node, figure)) {
      await painted();
      seen();
    }
    await plotly();
  }
  if (node.firstElementChild?.tagName === "svg") node.replaceChildren();
  await Plotly.react(node, shown, layout, overTime && place !== "map" && innerWidth > NARROW ? CONFIG : { ...CONFIG, displayModeBar: false });
  if (place === "surface") {
    seen();
    document.documentElement.dataset.firstPlot ??= Math.round(performance.now());
  }
  node.dataset.traces = data.length;
  node.dataset.name = spec.name;
  if (!node.dataset.linked && overTime) {
    node.dataset.linked = "1";
    if (place === "map") node.on("plotly_click", (e) => pick(Number(e.points[0].y)));
    node.on("plotly_relayout", (change) => zoomed(node, change));
    measure.grips(node);
  }
}

// Curves and layout of a figure, in the unit that its stretch has.
function timesOf(data, layout, figure, node) {
  const { unit, per } = shownIn(figure);
  node.dataset.per = per;
  if (per === 1) return data;
  layout.shapes = times(layout.shapes, per);
  layout.xaxis = { ...layout.xaxis, title: { ...layout.xaxis.title, text: `time, ${unit}` }, range: layout.xaxis.range.map((x) => x * per), exponentformat: "none" };
  return data.map((t) => (t.x ? { ...t, x: Array.from(t.x, (x) => (x === null ? null : x * per)) } : t));
}

// The axes of a figure for what all of its steps have in a stretch of time, bands too. A line between two samples is there where they are not.
function axesWithin(figure, layout, [from, to]) {
  const found = { yaxis: [], yaxis2: [] }, number = (y) => typeof y === "number" && !Number.isNaN(y);
  const take = (of, axis) => of?.x?.forEach((x, i) => {
    const y = of.y[i], before = of.x[i - 1], last = of.y[i - 1];
    if (!number(y) || x === null) return;
    if (x >= from && x <= to) found[axis].push(y);
    if (i && before !== null && number(last)) for (const end of [from, to]) if (before < end && end < x) found[axis].push(last + ((end - before) / (x - before)) * (y - last));
  });
  for (const d of figure.data) take(d, d.yaxis === "y2" ? "yaxis2" : "yaxis");
  const names = ticked(state.steps).map((s) => s.name);
  for (const s of figure.steps ?? []) {
    for (const of of [s.model, s.low, s.high]) take(of, "yaxis");
    if (!ui.closeUp || names.includes(s.name)) for (const of of [s.each, s.mean]) take(of, "yaxis2");
  }
  const axes = Object.entries(found).filter(([axis, ys]) => ys.length && layout[axis]);
  return Object.fromEntries(axes.map(([axis, ys]) => {
    const low = ys.reduce((a, b) => Math.min(a, b)), high = ys.reduce((a, b) => Math.max(a, b)), edge = 0.08 * Math.max(high - low, 0.1);
    return [axis, { ...layout[axis], range: [low - edge, high + edge] }];
  }));
}

// Where the residuals of the ticked steps lie, with an edge; null before a step is there.
function reach(figure) {
  const names = ticked(state.steps).map((s) => s.name), own = (figure.steps ?? []).filter((s) => names.includes(s.name) && s.span?.yaxis2).map((s) => s.span.yaxis2);
  if (!own.length) return null;
  const low = Math.min(...own.map((s) => s[0])), high = Math.max(...own.map((s) => s[1])), edge = 0.05 * Math.max(high - low, 0.1);
  return [low - edge, high + edge];
}

// Scales of the residual: the axis is that of all steps, the colours are those of the step in the map, until a person wishes otherwise.
for (const [id, key] of [["close-up", "closeUp"], ["same-colors", "sameColors"]]) {
  $(id).checked = ui[key];
  $(id).addEventListener("change", () => { keep({ [key]: $(id).checked }); drawing(() => draw(id === "close-up" ? "surface" : "map")); });
}

// Says in the picture of a core that the newest ticked step knows too little of it to draw one, or on what its band rests.
function unknown(layout, width) {
  const c = cells()?.[ui.cell - 1];
  if (c && c.core_C !== null && c.assumed_percent !== null) note(layout, [`no thermocouple: ± ${K(c.core_95_K, 2)}`, ...lines(assumed(c).slice(2), width)].join("<br>"), dark() ? "#ffc46b" : "#8a4b00");
  if (!c || c.core_C !== null) return;
  note(layout, `<b>Core not known: ± ${K(c.core_95_K, 2)}</b>`, dark() ? "#ff8a94" : "#b00020");
}
function note(layout, text, color) {
  layout.annotations = [...(layout.annotations ?? []), { text, xref: "paper", yref: "paper", x: 0.5, y: 0.98, yanchor: "top", showarrow: false, bgcolor: themed("#ffffff"), font: { size: 13, color } }];
}

// Says how many readings lie beyond the ends of the histogram, of each ticked step in its colour.
function beyond(layout, figure) {
  const order = state.steps.map((s) => s.name), names = ticked(state.steps).map((s) => s.name);
  const far = (figure.steps ?? []).filter((s) => names.includes(s.name) && s.beyond > 0);
  layout.annotations = far.map((s, i) => ({ text: `${s.beyond < 0.01 ? "under 1" : Math.round(100 * s.beyond)} % beyond ± 6 sd`, xref: "paper", yref: "paper", x: 0.01, y: 1, yanchor: "top", yshift: -15 * i, showarrow: false,
    bgcolor: themed("#ffffff"), font: { size: 12, color: colorOf(order.indexOf(s.name)) } }));
}

// All of the time that is drawn: that of the record, and of those that are laid over it.
const whole = () => (specs.drive?.figure ?? specs.surface?.figure)?.layout.xaxis.range;

// The cursors have moved: their lines alone are drawn anew.
function cursors() {
  for (const p of timed()) {
    const node = $(`plot-${p}`), own = specs[p]?.figure?.layout.shapes ?? [];
    if (node?.dataset.linked && !node.parentElement.hidden) Plotly.relayout(node, { shapes: times(themed([...own, ...measure.lines()]), perOf(node)) });
  }
}

// Tells what is shown to those who measure in it.
function tell() {
  const figure = specs.drive?.figure ?? specs.surface?.figure;
  if (!figure) return;
  const { unit, per } = shownIn(figure);
  measure.follow({ names: timed().filter((p) => p !== "map" && specs[p]?.figure).map((p) => specs[p].name), window: range ?? whole(), whole: whole(), record: ui.record, unit, per,
    seconds: SECONDS[unit], steps: ticked(state.steps).map((s) => s.name), query: tracks.query(), redraw: cursors });
}

// A zoom in one plot moves the others; what these tell of it is not a person's.
const moving = new Map(); // windows that each plot is on its way to
async function follow(node, window) {
  const to = window.map((x) => x * perOf(node));
  moving.set(node, [...(moving.get(node) ?? []), to.join()]);
  try { await Plotly.relayout(node, { "xaxis.range": to }); } finally { moving.get(node).shift(); }
}
function zoomed(one, change) {
  const to = change["xaxis.range"] || [change["xaxis.range[0]"], change["xaxis.range[1]"]], back = change["xaxis.autorange"];
  if (!back && (to[0] === undefined || moving.get(one)?.includes(to.join()))) return;
  zoomTo(back ? null : to.map((x) => Number(x) / perOf(one)));
  drawing(async () => {
    const others = timed().map((p) => $(`plot-${p}`)).filter((p) => p !== one && p.dataset.linked && !p.parentElement.hidden);
    await Promise.all(others.map((p) => follow(p, range ?? whole())));
    await resampled();
  });
}

// Asks for the samples of the window that is shown: of a short one all of them.
let sampling = 0;
async function resampled() {
  const mine = ++sampling, began = performance.now();
  const there = timed().filter((p) => specs[p]?.figure);
  const found = await Promise.all(there.map((p) => figureOf(p, specs[p].name)));
  if (mine !== sampling) return;
  for (const [i, p] of there.entries()) if (specs[p]?.figure) specs[p].figure = found[i];
  for (const p of there) {
    if (mine !== sampling) return;
    await draw(p);
  }
  if (mine !== sampling) return;
  $("stage").dataset.resampledMs = Math.round(performance.now() - began);
  $("stage").dataset.window = range ? range.join() : "";
  tell();
}

const figureOf = async (place, name) =>
  (await get("figure", { name, ...tracks.query(), ...(range && timed().includes(place) ? { from: range[0], to: range[1] } : {}) })).figure;

// Contours of two parameters, where somebody looks at them.
async function pairs() {
  const styles = new Map(state.steps.map((s, i) => [s.name, styleOf(i)])), node = $("plot-pair");
  const found = picture(state.steps, ticked(state.steps), (s) => styles.get(s.name), () => drawing(pairs));
  if (!found || !$("pairs").open || !window.Plotly) return;
  const [across, up] = [found.layout.xaxis.title.text, found.layout.yaxis.title.text.replace("<br>", " ")];
  const data = wrapped(themed(found.data), node, found.layout);
  node.style.height = `${found.layout.height}px`;
  node.setAttribute("role", "group");
  node.setAttribute("aria-label", `Contours of ${across} and ${up}; the sentence above tells the same`);
  await Plotly.react(node, data, themed(found.layout), { ...CONFIG, displayModeBar: false });
  node.dataset.pair = found.pair.join();
}

export const redraw = () => drawing(async () => {
  for (const place of places()) await draw(place);
  await pairs();
});
addEventListener("resize", afterwards(250, async () => { if (window.Plotly && state?.opened) await redraw(); }));
measure.prepare(() => { if (window.Plotly && state?.opened) cursors(); });

$("pairs").addEventListener("toggle", () => { if (state && $("pairs").open) drawing(pairs); });
$("leftover").addEventListener("toggle", () => { if (state && $("leftover").open) anew(); });

// Fetches the figures of the chosen record and cell, and draws them.
export async function show(next, fresh) {
  state = next;
  const opened = state.opened;
  $("nothing").hidden = Boolean(opened || state.looked);
  $("shown").hidden = !opened;
  if (!opened) {
    if (!state.job) plotly();
    return;
  }
  if (fresh) curves = new Map();
  if (!opened.records[ui.record]) keep({ record: 0 });
  const record = opened.records[ui.record];
  // the cell that fails most is shown first, until a person chooses another
  const of = JSON.stringify([opened.records.map((r) => r.source), state.files?.model]);
  if (ui.of !== of) { zoomTo(null); keep({ of, cell: 0, chosen: false }); }
  const there = ui.cell >= 1 && ui.cell <= opened.cells;
  if (!ui.chosen || !there) keep({ cell: worst() ?? (there ? ui.cell : record.cells[0]), chosen: worst() !== null });
  choices();
  tracks.show(state, anew);
  string();
  regimes();
  const mine = ++newest;
  for (const place of places()) {
    const name = place.startsWith("track-") ? place : ["drive", "map"].includes(place) ? `${place}-${ui.record}` : `${place}-${ui.record}-${ui.cell}`;
    const found = (state.figures.includes(name) || state.tracks.includes(name)) && (timed().includes(place) || $("leftover").open) ? await figureOf(place, name) : null;
    if (mine !== newest) return;
    specs[place] = { name, figure: found };
    await draw(place);
  }
  // a plot that was drawn before all of the time was known, that of records laid over it too
  for (const place of timed()) if (specs[place]?.figure && specs[place].drawn !== (range ?? whole())?.join()) await draw(place);
  await pairs();
  tell();
  $("stage").dataset.version = state.version;
}

const shown = () => ticked(state.steps).at(-1)?.variant;
const cells = () => shown()?.cells;

function worst() {
  const seen = (cells() ?? []).filter((c) => c.ratio !== null);
  return seen.length ? seen.reduce((a, b) => (b.ratio > a.ratio ? b : a)).cell : null;
}

function choices() {
  const select = $("record");
  $("record-choice").hidden = state.opened.records.length < 2;
  const last = state.opened.records.map((r) => r.source.split(/[\\/]/).pop()), called = (r, i) => (last.indexOf(last[i]) === last.lastIndexOf(last[i]) ? last[i] : r.source);
  select.replaceChildren(...state.opened.records.map((r, i) => el("option", { value: i, selected: i === ui.record, title: r.source }, called(r, i))));
  select.onchange = () => { zoomTo(null); keep({ record: Number(select.value) }); anew(); };
  const box = $("variants"), told = JSON.stringify([state.steps.map((s) => [s.name, s.core?.proven]), ui.off, dark()]);
  box.hidden = $("close-up-choice").hidden = $("same-colors-choice").hidden = state.steps.length < 2;
  if (box.dataset.told !== told) {
    box.dataset.told = told;
    const focused = document.activeElement?.id;
    box.replaceChildren(el("legend", { class: "hidden" }, "Steps shown"), ...state.steps.map(tick));
    if (focused?.startsWith("step-")) $(focused)?.focus();
  }
  const top = ticked(state.steps).at(-1);
  $("legend").textContent = top?.variant ? `In full: ${top.name}; the other ticked steps as ghosts, on the same axes. Colour of a cell: its error over the noise of its sensor. Grey ground: held out, never fitted to. Thin: reading minus model; thick: its mean over a minute; dotted: ± 2 sd of the sensor.${top.core?.proven === false ? " Hatched band: core not proven." : ""}` : "";
}

// A box to tick for one step, with its line and, where its core is not proven, a hatched band behind it.
function tick(s, i) {
  const [color, dash] = styleOf(i), box = el("input", { type: "checkbox", id: `step-${i}`, checked: !ui.off.includes(s.name), onchange: () => {
    const rest = ui.off.filter((x) => x !== s.name);
    keep({ off: box.checked ? rest : [...rest, s.name] });
    anew(); dispatchEvent(new Event("variant"));
  } });
  const line = el("i", { class: `line ${s.core?.proven === false ? "unproven" : ""}`, style: `--c:${themed(color)};border-top-style:${{ solid: "solid", dot: "dotted" }[dash] ?? "dashed"}` });
  return el("label", { class: "tick", for: `step-${i}` }, box, line, s.name);
}

function tint(ratio) {
  const share = Math.min(Math.max(Math.log10(Math.max(ratio, 1)) / 1.3, 0), 1); // 1 … 20 times the noise
  const mix = (a, b) => Math.round(a + (b - a) * share);
  return `rgb(${mix(255, 240)},${mix(255, 140)},${mix(255, 20)})`;
}

// On what the band of a core rests whose cell has no thermocouple.
const assumed = (c) => (c.assumed_percent === null ? "" : `, if its R_e is that of the other cells to within ${Number(c.assumed_percent.toPrecision(2))} % (1 sd)`);

function string() {
  const known = cells();
  const nodes = [];
  const coolant = state.opened.condition !== "single" && state.opened.cells > 1;
  if (coolant) nodes.push(el("span", { class: "flow" }, "coolant in →"));
  for (let k = 1; k <= state.opened.cells; k++) {
    const c = known?.[k - 1];
    const sensed = state.opened.sensors.includes(k);
    const told = !sensed ? "no sensor" : c?.error_K === undefined || c.error_K === null ? "sensor" : K(c.error_K, 2);
    const label = `cell ${k}: ${sensed ? (c ? `error ${K(c.error_K)}, ${c.ratio?.toFixed(1)} times the noise` : "sensor") : "no sensor"}` +
      (!c ? "" : c.core_C === null ? `; core not known (± ${K(c.core_95_K, 2)})` : `; core up to ${c.core_C.toFixed(1)} °C; ± ${K(c.core_95_K)} (95 %, rms over the record)${assumed(c)}`);
    if (k === ui.cell) $("cell-told").textContent = `${label[0].toUpperCase()}${label.slice(1)}`; // all that a finger can reach
    nodes.push(el("button", { class: `cell${sensed ? "" : " unseen"}`, type: "button", id: `cell-${k}`, title: label,
      "aria-pressed": String(k === ui.cell), style: sensed && c?.ratio ? `background:${tint(c.ratio)}` : null,
      onclick: () => pick(k) }, el("span", { class: "aloud" }, "cell "), el("b", {}, `${k}`), el("small", {}, told)));
  }
  if (coolant) nodes.push(el("span", { class: "flow" }, "→ out"));
  const focused = document.activeElement?.id;
  $("drawing").replaceChildren(...nodes);
  if (focused?.startsWith("cell-")) $(focused)?.focus();
}

export function pick(k) {
  if (!state?.opened || k < 1 || k > state.opened.cells) return;
  keep({ cell: k, chosen: true });
  anew();
}

function regimes() {
  const html = shown()?.regimes, name = ticked(state.steps).at(-1)?.name;
  $("regimes").hidden = !html;
  if (html && $("regimes").dataset.html !== html.length + name + state.version) {
    $("regimes").dataset.html = html.length + name + state.version;
    $("regimes").replaceChildren(el("h2", {}, `Error by regime: ${name}`), wide(el("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "table of errors by regime", html })));
  }
}

// Lays the curves of an effect over the plot, or takes them away again.
export function preview(name) {
  if (over === name) return;
  over = name;
  drawing(async () => {
    if (name && !curves.has(name)) curves.set(name, (await get("curves", { name })).curves);
    if (over === name) await draw("surface");
  });
}
