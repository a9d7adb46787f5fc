// The stage: string drawing, plots of the chosen cell with linked time axes, curves of an effect laid over them.
import { $, el, get, ui, keep, K, complain } from "./util.js";
import { sketch } from "./sketch.js";

const CONFIG = { displaylogo: false, responsive: true,
  modeBarButtons: [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"]] };
const DARK = { "#ffffff": "#16181b", "#1a1a1a": "#e8e8e8", "#000000": "#f2f2f2", "#4d4d4d": "#d0d0d0", "#e3e3e3": "#33373c",
  "#777777": "#9a9a9a", "#0072b2": "#6cb8ea", "#d55e00": "#ff9248", "rgba(0,0,0,0.075)": "rgba(255,255,255,0.09)",
  "#009e73": "#54c9a4", "#cc79a7": "#e3a0c6" };
const PLACES = ["surface", "drive", "core"];
let state = null;
let specs = {};
let curves = new Map();
let over = null; // effect whose curves are shown
let drawing = 0;
let range = null; // zoomed time, of the record

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

const wanted = (trace) => ui.variant === "both" || !trace.legendgroup || trace.legendgroup === ui.variant;

function laidOver(place) {
  const own = over && place === "surface" ? curves.get(over)?.[specs.surface?.name] : null;
  if (!own) return [];
  const line = { type: "scatter", mode: "lines", name: `with ${over}`, hoverinfo: "skip" };
  const color = dark() ? "#54c9a4" : "#009e73";
  return [
    { ...line, x: own.x, y: own.y, line: { color, width: 2.6 } },
    { ...line, x: own.at, y: own.residual, yaxis: "y2", showlegend: false, line: { color, width: 2.6 } },
  ];
}

async function draw(place) {
  const node = $(`plot-${place}`);
  const spec = specs[place];
  node.parentElement.hidden = !spec?.figure;
  if (!spec?.figure) return;
  const figure = themed(spec.figure);
  const layout = structuredClone(figure.layout);
  layout.xaxis.range = range ?? layout.xaxis.range;
  layout.uirevision = `${ui.record}`;
  // what was measured lies on top: a model that fits would hide it
  const measured = figure.data.filter((t) => t.name === "measured" && !t.yaxis);
  const data = [...figure.data.filter((t) => wanted(t) && !measured.includes(t)), ...laidOver(place), ...measured.map((t) => ({ ...t, legendrank: 1 }))];
  node.style.height = `${layout.height}px`;
  node.setAttribute("role", "group");
  node.setAttribute("aria-label", { surface: `Surface temperature of cell ${ui.cell}, measured and modelled, over time; below it the residual`,
    drive: "What drove the string: current, coolant inlet and what else is known, over time",
    core: `Core temperature of cell ${ui.cell} over time with its 95 percent band` }[place]);
  if (!window.Plotly) {
    if (place === "surface" && sketch(node, figure)) {
      await painted();
      seen();
    }
    await plotly();
  }
  if (node.firstElementChild?.tagName === "svg") node.replaceChildren();
  await Plotly.react(node, data, layout, CONFIG);
  if (place === "surface") {
    seen();
    document.documentElement.dataset.firstPlot ??= Math.round(performance.now());
  }
  node.dataset.traces = data.length;
  node.dataset.name = spec.name;
  if (!node.dataset.linked) {
    node.dataset.linked = "1";
    node.on("plotly_relayout", (change) => zoomed(node, change));
  }
}

let linking = false;
async function zoomed(one, change) {
  if (linking) return;
  const to = change["xaxis.range"] || [change["xaxis.range[0]"], change["xaxis.range[1]"]];
  if (!change["xaxis.autorange"] && to[0] === undefined) return;
  range = change["xaxis.autorange"] ? null : to.map(Number);
  linking = true;
  const whole = specs.drive?.figure?.layout.xaxis.range;
  const others = PLACES.map((p) => $(`plot-${p}`)).filter((p) => p !== one && p.dataset.linked && !p.parentElement.hidden);
  await Promise.all(others.map((p) => Plotly.relayout(p, { "xaxis.range": range ?? whole })));
  linking = false;
}

export async function redraw() {
  for (const place of PLACES) await draw(place);
}

// Fetches the figures of the chosen record and cell, and draws them.
export async function show(next, fresh) {
  state = next;
  const opened = state.opened;
  $("nothing").hidden = Boolean(opened);
  $("shown").hidden = !opened;
  if (!opened) {
    if (!state.job) plotly();
    return;
  }
  if (fresh) curves = new Map();
  if (!opened.records[ui.record]) keep({ record: 0 });
  const record = opened.records[ui.record];
  if (!(ui.cell >= 1 && ui.cell <= opened.cells)) keep({ cell: worst() ?? record.cells[0] });
  choices();
  string();
  regimes();
  const mine = ++drawing;
  const names = { surface: `surface-${ui.record}-${ui.cell}`, drive: `drive-${ui.record}`, core: `core-${ui.record}-${ui.cell}` };
  for (const place of PLACES) {
    const name = names[place];
    const found = state.figures.includes(name) ? (await get("figure", { name })).figure : null;
    if (mine !== drawing) return;
    specs[place] = { name, figure: found };
    await draw(place);
  }
  $("stage").dataset.version = state.version;
}

const cells = () => state.compared?.variants[ui.variant === "from its file" ? "from its file" : "refitted"].cells;

function worst() {
  const seen = (state.compared?.variants.refitted.cells ?? []).filter((c) => c.ratio !== null);
  return seen.length ? seen.reduce((a, b) => (b.ratio > a.ratio ? b : a)).cell : null;
}

function choices() {
  const select = $("record");
  $("record-choice").hidden = state.opened.records.length < 2;
  select.replaceChildren(...state.opened.records.map((r, i) => el("option", { value: i, selected: i === ui.record }, r.source)));
  select.onchange = () => { range = null; keep({ record: Number(select.value) }); show(state); };
  const box = $("variants");
  box.hidden = !state.compared;
  if (box.childElementCount < 2) {
    for (const name of ["refitted", "from its file", "both"]) {
      const id = `variant-${name.replaceAll(" ", "-")}`;
      const radio = el("input", { type: "radio", name: "variant", id, value: name, checked: ui.variant === name,
        onchange: () => { keep({ variant: name }); show(state); dispatchEvent(new Event("variant")); } });
      box.append(el("span", {}, radio, " ", el("label", { for: id }, name === "both" ? "both" : `model ${name}`)));
    }
  }
  $("legend").textContent = state.compared ? "Colour of a cell: its error over the noise of its sensor. Grey ground: held out, never fitted to. Thin: reading minus model; thick: its mean over a minute; dotted: ± 2 sd of the sensor." : "";
}

function tint(ratio) {
  const share = Math.min(Math.max(Math.log10(Math.max(ratio, 1)) / 1.3, 0), 1); // 1 … 20 times the noise
  const mix = (a, b) => Math.round(a + (b - a) * share);
  return `rgb(${mix(255, 240)},${mix(255, 140)},${mix(255, 20)})`;
}

function string() {
  const known = cells();
  const nodes = [];
  const coolant = state.opened.condition !== "single" && state.opened.cells > 1;
  if (coolant) nodes.push(el("span", { class: "flow" }, "coolant in →"));
  for (let k = 1; k <= state.opened.cells; k++) {
    const c = known?.[k - 1];
    const sensed = state.opened.sensors.includes(k);
    const told = !sensed ? "no sensor" : c?.error_K === undefined || c.error_K === null ? "sensor" : K(c.error_K);
    const label = `cell ${k}: ${sensed ? (c ? `error ${told}, ${c.ratio?.toFixed(1)} times the noise` : "sensor") : "no sensor"}` +
      (c ? `; core up to ${c.core_C?.toFixed(1)} °C, ± ${K(c.core_95_K)}` : "");
    nodes.push(el("button", { class: `cell${sensed ? "" : " unseen"}`, type: "button", id: `cell-${k}`, title: label, "aria-label": label,
      "aria-pressed": String(k === ui.cell), style: sensed && c?.ratio ? `background:${tint(c.ratio)}` : null,
      onclick: () => pick(k) }, el("b", {}, `${k}`), el("small", {}, told)));
  }
  if (coolant) nodes.push(el("span", { class: "flow" }, "→ out"));
  const focused = document.activeElement?.id;
  $("drawing").replaceChildren(...nodes);
  if (focused?.startsWith("cell-")) $(focused)?.focus();
}

export function pick(k) {
  if (!state?.opened || k < 1 || k > state.opened.cells) return;
  keep({ cell: k });
  show(state).catch((e) => complain(e.message));
}

function regimes() {
  const html = state.compared?.variants[ui.variant === "from its file" ? "from its file" : "refitted"].regimes;
  $("regimes").hidden = !html;
  if (html && $("regimes").dataset.html !== html.length + ui.variant + state.version) {
    $("regimes").dataset.html = html.length + ui.variant + state.version;
    $("regimes").replaceChildren(el("h2", {}, "Error by regime"), el("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "table of errors by regime", html }));
  }
}

// Lays the curves of an effect over the plot, or takes them away again.
export async function preview(name) {
  if (over === name) return;
  over = name;
  if (name && !curves.has(name)) {
    try { curves.set(name, (await get("curves", { name })).curves); } catch (e) { complain(e.message); return; }
  }
  if (over === name) await draw("surface");
}
