// What is open: the records, which string of several, the direct checks, and how the data were read.
import { $, el, counted, many, sentence } from "./util.js";

const short = (path) => path.split(/[\\/]/).pop();
const ALIKE = 3; // notes of one kind from which on they are one line

// Readings of the file, and what a fit takes of them where that is something else.
function readings(r) {
  const of = `${thousands(r.heard)} ${r.heard === 1 ? "reading" : "readings"} of cell${r.cells.length === 1 ? "" : "s"} ${counted(r.cells)}`;
  if (r.readings === r.heard) return of;
  const means = r.readings < 0.75 * r.heard;
  return `${of}; a fit takes ${thousands(r.readings)}${means ? ` means of ${Number(r.means_s.toPrecision(3))} s` : " of them"}`;
}
const thousands = (n) => n.toLocaleString("en");

// Notes that differ in numbers only, such as those of sixty cells, are one that unfolds.
function notes(all, by) {
  const kinds = new Map();
  for (const n of all) {
    const kind = n.note.replace(/: \S+\.\S+, .*/, ": a signal").replace(/[0-9]+(?:[.,][0-9]+)?/g, "#");
    kinds.set(kind, [...(kinds.get(kind) ?? []), n]);
  }
  const line = (n) => by(n) + sentence(n.note);
  return el("ul", {}, ...[...kinds.values()].flatMap((of) => (of.length < ALIKE ? of.map((n) => el("li", {}, line(n)))
    : [el("li", {}, el("details", { class: "alike" }, el("summary", {}, `${line(of[0])} And ${many(of.length - 1, "more of this kind", "more of this kind")}`), el("ul", {}, ...of.slice(1).map((n) => el("li", {}, line(n))))))])));
}

// Of a log with several strings one is open; the others are a choice away.
function strings(files, choose) {
  const all = files.strings ?? [];
  if (all.length < 2) return "";
  const select = el("select", { id: "string-choice", "data-work": true, onchange: () => choose(select.value) }, ...all.map((s) => el("option", { value: s, selected: s === files.string }, s)));
  return el("p", { id: "string-told" }, el("b", {}, `${files.string} of ${all.length}`), " strings of this log is open. ", el("label", { for: "string-choice" }, "Open another: "), select);
}

export function opened(state, fold, choose) {
  const o = state.opened;
  $("opened").replaceChildren();
  if (!o) return;
  const several = o.records.length > 1;
  const by = (x) => (several ? `${short(x.record)}: ` : "");
  $("opened").append(
    ...(state.dropped ? [el("p", { class: "alarm", id: "dropped" }, state.dropped)] : []),
    ...(state.session?.notes ? [el("h3", {}, "Notes"), el("p", { class: "written", id: "notes-told" }, state.session.notes)] : []),
    el("h3", {}, "Records"),
    strings(state.files, choose),
    el("ul", {}, ...o.records.map((r) => el("li", {}, `${short(r.source)}: ${r.minutes.toFixed(r.minutes < 10 ? 1 : 0)} min, ${readings(r)}${r.core ? "; a thermocouple in a core, used to judge only" : ""}`))),
    el("h3", {}, "Direct checks"),
    o.checks.length
      ? el("ul", { class: "checks" }, ...o.checks.map((c) => el("li", { class: c.severity }, el("b", {}, sentence(`${c.weight}: `)), by(c) + c.sentence)))
      : el("p", { class: "muted" }, "The checks found nothing wrong: signs, gaps, stuck sensors, soak and spans are plausible."),
    o.notes.length ? fold("notes", "How the data were read", notes(o.notes, by)) : "",
  );
}
