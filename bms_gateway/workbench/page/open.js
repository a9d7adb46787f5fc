// The table of columns: what each column of a foreign table is, with its unit and sign, guessed and to be confirmed.
import { $, el, get, post, ui, until, attempt, complain, many, sentence, wide } from "./util.js";

const ONCE = { time_s: "time", current_A: "current, discharge positive", coolant_inlet_C: "coolant inlet, or the air around",
  voltage_V: "voltage of the string", soc: "SOC (state of charge)", coolant_flow_m3_s: "coolant flow" };
const MANY = { surface: ["surface of cell", "C", "temperature"], core: ["core of cell", "C", "temperature"], cell_voltage: ["voltage of cell", "V", "voltage"] };
const QUANTITY = { time_s: "time", current_A: "current", coolant_inlet_C: "temperature", voltage_V: "voltage", soc: "soc", coolant_flow_m3_s: "flow" };
const DATES = ["dd/mm/yyyy", "mm/dd/yyyy"];
const SHOWN = { share: [100, "%"], "m³/s": [60000, "l/min"] };
const PLAIN = { time: "s", current: "A", temperature: "°C", voltage: "V", soc: "-", flow: "m3/s" };

let groups = []; // tables with the same columns: what the server told of each, and the rows that the person sees
let told = ""; // what the server told last
let opened = false; // a record is open
let asks = false; // this page has asked, or is about to
let given = new Map(); // columns of tables that are open, which nobody has looked at since

const parts = (ours) => { const m = /^(surface|core|cell_voltage)_(\d+)_/.exec(ours); return m ? [m[1], Number(m[2])] : [ours, 0]; };
const quantity = (what) => QUANTITY[what] ?? MANY[what]?.[2];
const ours = (r) => (MANY[r.what] ? `${r.what}_${r.cell}_${MANY[r.what][1]}` : r.what);
const unitOf = (look, c) => c.unit || (look.units[quantity(parts(c.ours)[0])]?.includes(c.stated) ? c.stated : "");
const header = (look) => (look.log ? `${look.log} ${look.source}` : look.columns.map((c) => c.name).join("\n"));
const last = (path) => path.split(/[\\/]/).pop();

export const table = () => groups.some((g) => g.rows.length > 0);

// The pairs that --columns takes; what the names tell by themselves needs none.
function pairs(g) {
  return g.rows.filter((r) => r.what && !(r.by === "name" && !r.touched)).map((r) => {
    const c = g.look.columns[r.at];
    const unit = r.unit && r.unit !== c.stated ? ` [${r.unit}]` : "";
    return `${ours(r)}=${r.flip ? "-" : ""}${r.name}${unit}`;
  }).concat(g.inlet && !hasInlet(g) ? [`coolant_inlet_C=${g.inlet}`] : []);
}

// Takes what the server found in the tables; what a person chose before stays where the columns are the same. A page that has
// asked for nothing yet knows less than the server, which may still be at work on what the page before it has sent.
export function show(found, isOpen) {
  if (isOpen !== opened) { opened = isOpen; if (groups.length) draw(); }
  const now = JSON.stringify([found, $("config").value, $("dbc").value]); // what a log still needs is said too
  if (!found || now === told) return;
  told = now;
  const before = groups;
  groups = [];
  for (const look of found.tables) {
    const same = groups.find((g) => header(g.look) === header(look));
    if (same) { same.sources.push(look.source); continue; }
    const old = !asks ? null : before.find((g) => header(g.look) === header(look));
    const g = { look, sources: [look.source], inlet: old?.inlet ?? look.inlet ?? "", rows: old?.rows ?? look.columns.map((c, at) => {
      const [what, cell] = parts(c.ours);
      return { at, name: c.name, what, cell, unit: unitOf(look, c), flip: c.flip, by: c.by, why: c.why, touched: false };
    }) };
    groups.push(g);
  }
  if (table()) $("columns").value = "";
  draw();
}

const twice = (g) => { const all = g.rows.filter((r) => r.what); return all.filter((r, i) => all.findIndex((x) => ours(x) === ours(r)) !== i).map((r) => (MANY[r.what] ? `${MANY[r.what][0]} ${r.cell}` : ONCE[r.what].split(",")[0])); };
const hasInlet = (g) => g.rows.some((r) => r.what === "coolant_inlet_C");
const lacking = (g) => ["time_s", "current_A", "coolant_inlet_C"].filter((x) => !g.rows.some((r) => r.what === x) && !(g.inlet && x === "coolant_inlet_C")).map((x) => ONCE[x].split(",")[0])
  .concat(g.rows.some((r) => r.what === "surface") ? [] : ["surface of a cell"]);

// A change of a field is told before Tab moves the focus: what was drawn anew at once would leave Tab no field to go to.
const redraw = () => setTimeout(draw, 0);

function draw() {
  const box = $("mapping"), shown = groups.filter((g) => !opened || !g.look.log);
  box.hidden = !shown.length;
  if (box.hidden) return;
  const focused = document.activeElement?.id;
  const tables = () => [...box.querySelectorAll(".scroll")], down = tables().map((t) => t.scrollTop);
  box.replaceChildren(...shown.flatMap(columnsOf));
  tables().forEach((t, i) => { t.scrollTop = down[i] ?? 0; });
  if (focused && document.activeElement?.id !== focused) $(focused)?.focus({ preventScroll: true });
}

function columnsOf(g) {
  const { look } = g, names = g.sources.join(", "), k = groups.indexOf(g);
  if (look.log) {
    const by = $("config").value.trim(), dbc = $("dbc").value.trim().split("\n").map(last).join(", ");
    return [el("p", {}, `${names} is a CAN log (${look.log}). ${by ? `Its signals are those that ${last(by)} names.` : dbc ? `Its signals are found with ${dbc}, as init finds them, when it is opened.`
      : "It needs a gateway config; or drop its DBC file here, and the signals are found as init finds them."}`)];
  }
  const guessed = g.rows.filter((r) => r.by === "guess").length, lack = lacking(g), double = twice(g);
  return [el("h3", {}, `Columns of ${names}`),
    el("p", { class: lack.length || double.length ? "alarm" : "muted", id: k ? `mapping-told-${k}` : "mapping-told", role: "status" },
      double.length ? `Two columns are taken for ${double[0]}.` : lack.length ? `Still missing: ${lack.join(", ")}.`
        : guessed ? `${many(guessed, "column is", "columns are")} guessed (marked ?): check ${guessed === 1 ? "it, with its unit and sign" : "them, with their units and signs"}.` : "The names of the columns say what they are."),
    hasInlet(g) ? "" : constant(g, k),
    wide(el("div", { class: "scroll", id: k ? `mapping-table-${k}` : "mapping-table", tabindex: "0", role: "group", "aria-label": `columns of ${names}` },
      el("table", { class: "columns" }, el("thead", {}, el("tr", {}, ...["Column", "First values", "Is", "Unit", "Sign −", "Read as"].map((t) => el("th", { scope: "col" }, t)))),
        el("tbody", {}, ...g.rows.map((r) => line(g, r)))))),
    look.notes.length ? el("p", { class: "muted" }, `${sentence(look.notes.join("; "))}`.replace(/[^.?]$/, "$&.")) : ""];
}

// Chambers are often set, and not recorded: their temperature is typed then.
function constant(g, k) {
  const id = k ? `inlet-${k}` : "inlet";
  return el("p", {}, el("label", { for: id, class: "typed" }, "No column has the inlet, or the air around? It was, all along (°C where no unit is written) "),
    el("input", { id, value: g.inlet, class: "some", inputmode: "text", autocomplete: "off", placeholder: "22 °C", onchange: (e) => { g.inlet = e.target.value.trim(); redraw(); again(); } }));
}

function line(g, r) {
  const { look, rows } = g, k = groups.indexOf(g), c = look.columns[r.at], id = `${k ? `table-${k}-` : ""}column-${r.at}`;
  const options = [["", "not used"], ...Object.entries(ONCE), ...Object.entries(MANY).map(([k, v]) => [k, v[0]])];
  const change = (more) => { Object.assign(r, more, { touched: true, by: r.by === "guess" ? "told" : r.by }); redraw(); again(); };
  const what = el("select", { id, "aria-label": `${r.name} is`, onchange: (e) => {
    const next = e.target.value;
    const others = rows.filter((x) => x !== r && x.what === next).map((x) => x.cell);
    let cell = r.cell || Number(/(\d+)(?!.*\d)/.exec(r.name)?.[1] ?? 1) || 1;
    while (MANY[next] && others.includes(cell)) cell += 1;
    change({ what: next, cell, unit: look.units[quantity(next)]?.includes(c.stated) ? c.stated : "", flip: false });
  } }, ...options.filter(([k]) => k || c.by !== "name").map(([k, t]) => el("option", { value: k, selected: k === r.what }, t)));
  const cell = MANY[r.what] ? el("input", { id: `${id}-cell`, type: "number", min: "1", max: "400", value: String(r.cell), "aria-label": `cell of ${r.name}`, class: "few",
    onchange: (e) => change({ cell: Math.max(1, Math.round(Number(e.target.value)) || 1) }) }) : "";
  const known = look.units[quantity(r.what)] ?? [];
  const own = PLAIN[quantity(r.what)];
  const units = r.what === "time_s" && !("low" in c) ? ["", ...DATES] : ["", ...known];
  const unit = r.what ? el("select", { id: `${id}-unit`, "aria-label": `unit of ${r.name}`, onchange: (e) => change({ unit: e.target.value }) },
    ...units.map((u) => el("option", { value: u, selected: u === r.unit }, u || (units.includes(DATES[0]) ? "as written" : `${own} (assumed)`)))) : c.stated;
  const flip = r.what && r.what !== "time_s" ? el("input", { id: `${id}-flip`, type: "checkbox", checked: r.flip, "aria-label": `opposite sign of ${r.name}`, onchange: (e) => change({ flip: e.target.checked }) }) : "";
  const [scale, told] = SHOWN[c.in] ?? [1, c.in];
  const number = (x) => (Math.abs(x) >= 1e5 ? x.toExponential(2) : String(Number(x.toPrecision(4)))).replace("-", "−");
  const seen = "low" in c && r.what ? el("span", {}, curve(c.points), ` ${number(scale * c.low)} to ${number(scale * c.high)} ${told}`) : "";
  return el("tr", { class: r.what ? "" : "unused" }, el("th", { scope: "row" }, c.name), el("td", { class: "muted" }, firsts(c.cells).join("  ")),
    el("td", {}, what, cell, r.by === "guess" ? el("small", { class: "muted why" }, `? Guessed${r.why ? `: ${r.why}` : ""}`) : ""), el("td", {}, unit), el("td", {}, flip), el("td", {}, seen));
}

// A number to a few digits, with the mark that it has.
const short = (text) => (/^-0*[.,]?0*$/.test(text) && text.includes("0") ? "0" : text.length > 12 ? `${text.slice(0, 11)}…` : text.replace(/([.,]\d*?[1-9]?)0+$/, "$1").replace(/[.,]$/, ""));

// The first two values; of two that begin alike, such as dates, the second by what comes after its last blank.
const LIKE = 11;
function firsts(cells) {
  const [one, other] = cells, end = /[\sT](\S{1,12})$/.exec(other ?? "")?.[1].replace(/^.*T/, "");
  if (!end || one.length > 24 || one === other || one.slice(0, LIKE) !== other.slice(0, LIKE)) return cells.slice(0, 2).map(short);
  return [one, `…${end}`];
}

// A curve of the first values, without axes.
function curve(points) {
  const known = points.filter((y) => y !== null), low = Math.min(...known), span = Math.max(...known) - low || 1;
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  for (const [k, v] of Object.entries({ viewBox: "0 0 60 16", width: "60", height: "16", "aria-hidden": "true" })) svg.setAttribute(k, v);
  const path = document.createElementNS("http://www.w3.org/2000/svg", "polyline");
  path.setAttribute("points", points.map((y, i) => (y === null ? "" : `${(60 * i) / Math.max(points.length - 1, 1)},${15 - (14 * (y - low)) / span}`)).join(" "));
  path.setAttribute("fill", "none");
  path.setAttribute("stroke", "currentColor");
  svg.append(path);
  return svg;
}

// Shows the values by the units and signs that are chosen now, once nothing more was chosen for a moment.
const CHOSEN_MS = 200;
let choices = 0, waiting = 0; // the choice that waits to be looked at; 0: none
function again() {
  asks = true;
  waiting = 0;
  if (groups.some((g) => twice(g).length)) return;
  const mine = waiting = ++choices;
  until(async () => {
    await new Promise((done) => setTimeout(done, CHOSEN_MS));
    if (waiting === mine) { waiting = 0; await ask(); }
  }).catch((e) => complain(e.message));
}

// A page that goes away within this moment sends the choice as it leaves.
addEventListener("pagehide", () => {
  if (!waiting) return;
  waiting = 0;
  const body = new Blob([JSON.stringify({ tables: tables(), columns: said(), each: each() })], { type: "application/json" });
  navigator.sendBeacon(`/api/look?${new URLSearchParams({ desk: ui.desk })}`, body);
});

// What was chosen last is looked at, and shown, before the tables are opened: a reload shows it then, and columns that are guessed are said to the reader.
const LOOKS_MS = 200;
export async function settled() {
  if (waiting) {
    waiting = 0;
    await ask();
  }
  await asked.catch(() => null); // what was wrong with it is told where it was asked for
  for (;;) {
    const state = await get("state");
    if (state.job?.kind !== "look") { show(state.looked, Boolean(state.opened)); return; }
    await new Promise((done) => setTimeout(done, LOOKS_MS));
  }
}

export const tables = () => $("tables").value.split("\n").map((t) => t.trim()).filter(Boolean);
export const said = () => ($("columns").value.trim() ? [$("columns").value.trim()] : []);

// The columns of each table in its place: as they are chosen here, or as it is open.
export const each = () => tables().map((t) => {
  const g = groups.find((x) => x.sources.includes(last(t)));
  return g ? pairs(g) : given.get(t) ?? [];
});
export const keep = (files) => { given = new Map(files.tables.map((t, k) => [t, files.each?.[k] ?? []])); };

// One after the other: what is asked last is told last.
let asked = Promise.resolve();
export const ask = () => {
  asks = true;
  const mine = asked.catch(() => null).then(() => post("look", { tables: tables(), columns: said(), each: each() }));
  asked = mine;
  return mine;
};

// What a person says of the cell, where there is no model file.
export function form() {
  const cell = [$("form-cell").value.trim(), $("form-parallel").value.trim() && `${$("form-parallel").value.trim()}p`, $("form-cooling").value].filter(Boolean).join(" ");
  return $("form-cell").value.trim() ? { cell, cells: $("form-cells").value.trim(), sensors: $("form-sensors").value.trim(), flow: $("form-flow").value.trim(), medium: $("form-medium").value } : null;
}

export function fill(given) {
  const words = (given?.cell ?? "").split(" ").filter(Boolean);
  const take = (test) => { const i = words.findIndex((w, k) => k > 0 && test(w)); return i < 0 ? "" : words.splice(i, 1)[0]; };
  $("form-parallel").value = take((w) => /^\d+p$/.test(w)).replace("p", "");
  $("form-cooling").value = take((w) => ["still", "forced", "plate", "liquid"].includes(w));
  $("form-cell").value = words.join(" ");
  for (const k of ["cells", "sensors", "flow"]) $(`form-${k}`).value = given?.[k] ?? "";
  $("form-medium").value = given?.medium ?? "";
  $("describe").open = Boolean(given);
}

// The catalogue comes when somebody opens the form.
let offered = false;
export const offer = attempt(async () => {
  if (offered || !$("describe").open) return;
  offered = true;
  const { presets } = await get("presets");
  $("presets").replaceChildren(...presets.map((p) => el("option", { value: p.name, label: p.told })));
});

export const prepare = attempt(async () => { if (tables().length) await ask(); });
