// What is shown beside a record: other records laid over it, and further columns of its table as tracks of their own.
import { $, el, post, ui, keep, complain } from "./util.js";

const short = (path) => path.split(/[\\/]/).pop();
const MOST = 32; // letters of a file's name in a legend; its box to tick has all of it
const brief = (path) => { const name = short(path); return name.length > MOST ? `${name.slice(0, MOST - 12)}…${name.slice(-11)}` : name; };
const COLORS = [["#7b3294", "#c79be0"], ["#8c6d00", "#e0c25a"], ["#00796b", "#5fd3c4"], ["#a6004f", "#ff8fc0"]];
let state = null, again = null;
let tried = new Set();

const others = () => state.opened.records[ui.record]?.others ?? [];
const mine = () => ui.tracks.filter((t) => t.record === ui.record);
const nameOf = (t) => `track-${t.record}-${others().findIndex((c) => c.name === t.column)}`;

// Names of the tracks of this record that are there; they are places of the page too.
export const shown = () => (state?.opened ? mine().map(nameOf).filter((n) => state.tracks.includes(n)) : []);

// What the server is to lay over the figures.
export const query = () => {
  const on = state?.opened ? ui.beside.filter((r) => r !== ui.record && r < state.opened.records.length) : [];
  return on.length ? { beside: on.join(), by: ui.by } : {};
};

const color = (record, dark) => COLORS[record % COLORS.length][dark ? 1 : 0];

// Curves of the other records: what was measured solid, the newest ticked model dashed, its mean residual below.
export function curves(figure, dark, top) {
  return (figure.beside ?? []).flatMap((b) => {
    const own = { color: color(b.record, dark), width: 1.2 };
    const data = b.data.map((d) => ({ ...d, name: brief(b.source), legendgroup: b.source, showlegend: d.name === "measured" || d.name === "thermocouple in the core", line: { ...d.line, ...own, dash: d.meta ? "dash" : "solid" } }));
    const step = b.steps.find((s) => s.name === top);
    const line = (of, more) => ({ type: "scatter", mode: "lines", ...of, legendgroup: b.source, line: { ...own, width: 1.6, dash: "dash" }, ...more });
    if (step?.model) data.push(line(step.model, { name: `${brief(b.source)}, ${top}`, showlegend: true }));
    if (step?.mean) data.push(line(step.mean, { name: brief(b.source), showlegend: false, yaxis: "y2" }));
    return data;
  });
}

// Draws the choices, and sees to it that every wanted track is read.
export function show(next, redraw) {
  if (state?.opened?.records !== next.opened?.records && JSON.stringify(state?.opened?.records) !== JSON.stringify(next.opened?.records)) tried = new Set();
  state = next;
  again = redraw;
  laid();
  choice();
  const there = shown();
  for (const f of [...$("tracks").children]) if (!there.includes(f.dataset.track)) f.remove();
  for (const t of mine().filter((one) => there.includes(nameOf(one)))) {
    const name = nameOf(t);
    if (document.getElementById(`plot-${name}`)) continue;
    $("tracks").append(el("figure", { "data-track": name }, el("button", { type: "button", class: "away", "aria-label": `take the track ${t.column} away`, title: "take this track away", onclick: () => drop(t) }, "×"),
      el("div", { class: "plot", id: `plot-${name}`, "data-column": t.column })));
  }
  read();
}

function drop(t) {
  keep({ tracks: ui.tracks.filter((x) => x.record !== t.record || x.column !== t.column) });
  tried.delete(`${t.record} ${t.column}`);
  again();
  $("track-choice").focus();
}

// One at a time; what could not be read is not wanted any more, and the page says why.
function read() {
  if (state.job) return;
  const next = mine().find((t) => !state.tracks.includes(nameOf(t)));
  if (!next) return;
  const key = `${next.record} ${next.column}`;
  if (tried.has(key) || !others().some((c) => c.name === next.column)) { drop(next); return; }
  tried.add(key);
  post("track", next).catch((e) => { complain(e.message); drop(next); });
}

function laid() {
  const records = state.opened.records, rest = records.map((r, i) => [r, i]).filter(([, i]) => i !== ui.record);
  const box = $("beside");
  box.hidden = rest.length === 0;
  const told = JSON.stringify([records.map((r) => r.source), ui.record, ui.beside, ui.by, document.documentElement.dataset.theme]);
  if (box.hidden || box.dataset.told === told) return;
  box.dataset.told = told;
  const dark = document.documentElement.dataset.theme === "dark", focused = document.activeElement?.id;
  const ours = records[ui.record].clock, dated = rest.every(([r]) => ours && r.clock === ours);
  const why = !dated ? records.every((r) => r.clock) ? " (their clocks differ: a date, a time of day, with and without a time zone)" : " (not all have one)" : ours === "local" ? " (no time zone: taken as the same)" : "";
  if (!dated && ui.by === "clock") keep({ by: "start" });
  const by = el("select", { id: "beside-by", onchange: (e) => { keep({ by: e.target.value }); again(); } },
    el("option", { value: "start", selected: ui.by === "start" }, "by their start"), el("option", { value: "clock", selected: ui.by === "clock", disabled: !dated }, `by wall clock${why}`));
  box.replaceChildren(el("legend", {}, "Laid over it"), ...rest.map(([r, i]) => {
    const tick = el("input", { type: "checkbox", id: `beside-${i}`, checked: ui.beside.includes(i), onchange: () => {
      keep({ beside: tick.checked ? [...ui.beside, i] : ui.beside.filter((x) => x !== i) });
      again();
    } });
    return el("label", { class: "tick", for: `beside-${i}` }, tick, el("i", { class: "line", style: `--c:${color(i, dark)}` }), short(r.source));
  }), el("label", { for: "beside-by" }, "aligned "), by);
  if (focused?.startsWith("beside")) $(focused)?.focus();
}

function choice() {
  const free = others().filter((c) => !mine().some((t) => t.column === c.name));
  $("track-from").hidden = others().length === 0;
  const select = $("track-choice"), told = JSON.stringify([ui.record, free]);
  if (select.dataset.told === told) return;
  select.dataset.told = told;
  select.replaceChildren(el("option", { value: "" }, "a column of the table …"), ...free.map((c) => el("option", { value: c.name }, c.unit && !c.name.includes(c.unit) ? `${c.name}, ${c.unit}` : c.name)));
  select.title = "Arrow keys go through the columns, Enter draws the one that is shown";
  let keyed = false;
  select.onpointerdown = () => { keyed = false; };
  select.onkeydown = (e) => { if (e.key === "Enter" && keyed) { e.preventDefault(); chosen(); } else keyed = e.key !== "Enter"; };
  select.onchange = () => { if (!keyed) chosen(); };
  const chosen = () => {
    if (!select.value) return;
    tried.delete(`${ui.record} ${select.value}`);
    keep({ tracks: [...ui.tracks, { record: ui.record, column: select.value }] });
    if (state.job) complain("the column is read as soon as the page has nothing else to do", state.job.title);
    again();
  };
}
