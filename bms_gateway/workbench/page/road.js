// The panels of the road: open, compare, diagnose, add, take away.
import { $, el, get, post, upload, attempt, ui, keep, K, complain, counted, many, sentence, wide } from "./util.js";
import * as columns from "./open.js";
import { put as keepUpload, opened as uploadsOpened, changed, lacking } from "./kept.js";
import { colorOf, preview, ticked } from "./plots.js";
import { noteBox, noted, sent, withNotes } from "./notes.js";
import { opened } from "./records.js";

let state = null;
export const busy = () => Boolean(state?.job);
// A double click asks once.
const DOUBLE_MS = 500;
let asked = { told: "", at: -DOUBLE_MS };
function twice(what, body) {
  const at = performance.now(), told = JSON.stringify([what, body]), again = asked.told === told && at - asked.at < DOUBLE_MS;
  asked = { told, at };
  return again;
}
export const work = async (what, body) => { if (!twice(what, body)) await attempt(() => post(what, body))(); };
export const diagnose = () => work("diagnose");
export const undo = () => work("undo");
// What is only read from a session file is computed by the program: every diagnosis of it, of whichever model.
const computed = (id) => el("button", { type: "button", id, "data-work": true, onclick: () => work("confirm") }, "Compute it again");
const recalled = (s) => s.remains.startsWith("By the session file");

const words = (text) => text.split("\n").map((t) => t.trim()).filter(Boolean);
const fold = (id, title, ...inside) =>
  el("details", { id, open: ui.open.includes(id), ontoggle: (e) => {
    const rest = ui.open.filter((x) => x !== id);
    keep({ open: e.target.open ? [...rest, id] : rest });
  } }, el("summary", {}, title), ...inside);
// In narrow places a long symbol may be broken after its points and underscores.
const soft = (html) => html.replace(/(<th scope="row">)([^<]*)/g, (_, head, label) => head + label.replace(/\S{12,}/g, (word) => word.replace(/[._]/g, "$&<wbr>")));
const softly = (text) => text.split(/(?<=[._])(?=\S)/).flatMap((part, i) => (i ? [el("wbr"), part] : [part]));
const scroll = (name, html) => wide(el("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": name, html: soft(html) }));

export function prepare() {
  $("what").addEventListener("click", () => $("what").setAttribute("aria-expanded", String($("what").getAttribute("aria-expanded") !== "true"))); // it is cut otherwise
  let opening = false; // a second click asks for nothing more
  $("open-form").addEventListener("submit", (e) => {
    e.preventDefault();
    if (opening) return;
    opening = true;
    open().finally(() => { opening = false; });
  });
  const open = attempt(async () => {
    await taking; // files that were chosen are there first
    await columns.settled();
    await post("open", { tables: words($("tables").value), model: $("model").value.trim(), config: $("config").value.trim(),
      dbc: words($("dbc").value), form: columns.form(), string: $("string").value.trim(), recent: $("recent").value.trim(), store: $("store").value.trim(),
      columns: columns.said(), each: columns.each() });
    uploadsOpened();
    replaced = [];
    unkept();
  });
  $("example").addEventListener("click", attempt(() => post("open", { tables: ["example: bench.csv.gz"], model: "example: bench.toml" })));
  $("tables").addEventListener("change", columns.prepare);
  $("describe").addEventListener("toggle", columns.offer);
  for (const field of ["tables", "model", "config"]) {
    $(`${field}-file`).addEventListener("change", attempt(async (e) => {
      await take([...e.target.files], field);
      e.target.value = "";
    }));
  }
  $("session-file").addEventListener("change", attempt(async (e) => {
    const files = [...e.target.files];
    e.target.value = "";
    await take(files);
  }));
  unkept();
  // what is filled in and not yet opened outlives a reload
  for (const f of fields()) f.value = ui.typed?.[f.id] ?? f.value;
  $("describe").open = Boolean(ui.typed?.["form-cell"]);
  $("open-form").addEventListener("input", typed);
  addEventListener("dragover", (e) => e.preventDefault());
  addEventListener("drop", attempt(async (e) => { e.preventDefault(); await take([...e.dataTransfer.files]); }));
  addEventListener("variant", () => state && compare());
}

const fields = () => [...$("open-form").querySelectorAll("input:not([type=file]), textarea, select")];
const typed = () => keep({ typed: Object.fromEntries(fields().map((f) => [f.id, f.value])) });

// Opens a session; where it lacks files it waits for them to be uploaded.
let waiting = null;
export async function resume(session) {
  waiting = null;
  await post("resume", session).catch((e) => {
    if (e.message.startsWith("session: upload ")) waiting = session;
    throw e;
  });
  uploadsOpened();
}

// Files of one name that come together are all kept: those after the first get a number.
function apart(files) {
  const taken = new Set(files.map((f) => f.name)), seen = new Set();
  return files.map((f) => {
    let { name } = f;
    for (let k = 2; seen.has(name); k++) {
      const [, stem, ending] = /^(.*?)((?:\.[a-z0-9]{1,6}){0,2})$/i.exec(f.name), next = `${stem} (${k})${ending}`;
      name = taken.has(next) ? name : next;
    }
    seen.add(name);
    return name === f.name ? f : new File([f], name);
  });
}

// What this browser does not keep is said as long as it is so.
let replaced = []; // names of files of the last upload that took the place of others, until they are opened
export function unkept() {
  const told = lacking(), anew = changed().join(", "), other = replaced.filter((name) => !changed().includes(name)).join(", ");
  $("unkept").hidden = !told && !anew && !other;
  $("unkept").textContent = [
    other && `${other}: a file of this name with other content was here, and this one has taken its place. To work with both, give one of them another name and upload it again.`,
    told && `Not kept in this browser: ${told}. When the program is started anew, or this tab is duplicated, upload it again.`,
    anew && `${anew}: uploaded again after it was opened. What is shown is of the file before, and does not come back when the program is started anew; Open opens the file that was uploaded last.`,
  ].filter(Boolean).join(" ");
}

async function sessionIn(file) {
  let found = null;
  try { found = JSON.parse(await file.text()); } catch { /* told below */ }
  if (found === null || typeof found !== "object" || Array.isArray(found)) throw new Error(`${file.name}: no session file of the workbench`);
  return found;
}

// Files on their way; what goes wrong with them is told where they were chosen.
let taking = Promise.resolve();
function take(files, field = null) {
  const mine = taken(files, field);
  taking = Promise.all([taking, mine.catch(() => null)]);
  return mine;
}

// Uploads files into the field that they were chosen for, or by their kind where they were dropped; a session comes last.
async function taken(files, field) {
  const named = files.filter((f) => /\.json$/i.test(f.name));
  replaced = [];
  for (const file of apart(files.filter((f) => !named.includes(f)))) {
    const { name, replaced: other } = await upload(file);
    if (other) replaced.push(name);
    await keepUpload(file, name);
    const kind = /\.(dbc|kcd|arxml|sym)$/i.test(name) ? "dbc" : name.endsWith(".toml") ? (/^\s*\[\[string\]\]/m.test(await file.text()) ? "config" : "model") : "tables";
    const to = kind === "dbc" ? (field === "config" ? null : "dbc") : field === "config" && kind !== "config" ? null : field ?? kind;
    if (to === "tables" || to === "dbc") $(to).value = [...new Set([...words($(to).value), name])].join("\n");
    else if (to) $(to).value = name;
    if (to === "dbc" || to === "config") $("more").open = true;
  }
  typed();
  unkept();
  const session = named.length ? await sessionIn(named[0]) : waiting;
  if (session) await resume(session);
  else if (field !== "model" && field !== "config" && columns.tables().length) await columns.ask();
}

const short = (path) => path.split(/[\\/]/).pop();

export function show(next) {
  if (state && next.steps.length > state.steps.length) field.value = "";
  const first = state?.files !== next.files && JSON.stringify(state?.files) !== JSON.stringify(next.files);
  state = next;
  // what a restart of the program needs, at once; while it goes its way again the longer way is kept
  if (state.session && !state.resuming) keep({ session: state.session });
  const given = !state.files && state.looked?.files; // what the command line named, and could not be opened as it is
  if (given && !$("tables").value.trim()) {
    $("tables").value = given.tables.join("\n");
    for (const name of ["model", "config", "string"]) $(name).value ||= given[name] ?? "";
    typed();
  }
  columns.show(state.looked, Boolean(state.opened));
  if (first && state.files) {
    const named = state.session.files; // without what was made of them
    $("tables").value = state.files.tables.join("\n");
    for (const field of ["model", "config", "string"]) $(field).value = named[field];
    $("recent").value = ""; // taken: it is a table now
    $("store").value = state.files.recent?.store ?? "";
    $("dbc").value = named.dbc.join("\n");
    columns.fill(named.form);
    columns.keep(state.files);
    $("columns").value = columns.table() ? "" : state.files.columns.join(",");
    $("more").open = Boolean(named.config || named.dbc.length || $("columns").value || state.files.recent?.store);
  }
  if ((state.opened || state.looked) && $("start").contains(document.activeElement)) $("tab-open").focus({ preventScroll: true }); // it goes away
  $("start").hidden = Boolean(state.opened || state.looked);
  const added = state.steps.filter((s) => s.words.length);
  $("what").textContent = state.opened ? `${state.opened.records.map((r) => short(r.source)).join(", ")} · ${short(state.files.model)}${added.map((s) => ` ${s.name}`).join("")}` : "";
  $("what").hidden = !state.opened;
  document.title = `${added.at(-1)?.name ?? "Workbench"} · bms-gateway`;
  const focused = document.activeElement?.id;
  doubt(); opened(state, fold, (string) => { $("string").value = string; typed(); $("open-form").requestSubmit(); }); onward(); compare(); verdict(); adding(); away();
  settle();
  if (focused && document.activeElement?.id !== focused) $(focused)?.focus({ preventScroll: true });
}

// The way on from what was opened, in one click.
function onward() {
  if (!state.opened || state.diagnosed) return;
  const go = () => { dispatchEvent(new CustomEvent("tab", { detail: "diagnose" })); return diagnose(); };
  $("opened").prepend(el("p", {}, el("button", { type: "button", id: "onward", class: "main", "data-work": true, onclick: go }, "What is missing?")));
}

// While the desk works, nothing else can be asked of it.
function settle() {
  for (const b of document.querySelectorAll("[data-work]")) b.disabled = busy() || b.dataset.off === "1";
}

// What is to be doubted of the newest model: said on every step, until it is no longer so.
function doubt() {
  const top = state.steps.at(-1), probes = top?.variant?.core_measured.filter((m) => m.alarm) ?? [];
  $("doubt").hidden = !top || (!top.worse && !top.remains && !probes.length && top.core?.proven !== false);
  $("doubt").replaceChildren(...[
    top?.worse && el("span", { class: "danger" }, `${top.worse} `),
    top?.remains && el("span", { title: top.remains }, `${top.remains.split(":")[0]}. `),
    top?.remains && recalled(top) && computed("confirm-head"),
    top?.core?.proven === false && el("span", { title: top.core.why.join(" ") }, `${top.core.sentence} `),
    ...probes.map((m) => el("span", { class: "danger" }, `${m.sentence} `))].filter(Boolean));
}

const none = (text) => [el("p", { class: "muted" }, text)];
const NOTHING = "Open a table and a model first.";

function compare() {
  const c = state.compared;
  const box = $("panel-compare");
  box.replaceChildren(el("h2", {}, "Compare"));
  if (!c) {
    box.append(...none(state.opened ? "Not yet compared with the model." : NOTHING));
    if (state.opened) box.append(el("button", { class: "main", type: "button", id: "compare", "data-work": true, onclick: () => work("compare") }, "Compare"));
    return;
  }
  const { title, variant: v, remains, worse, core: known, tables: t } = ticked(state.steps).at(-1);
  if (remains) box.append(el("p", { class: "alarm" }, remains));
  if (worse) box.append(el("p", { class: "danger worse" }, worse));
  box.append(...core(known), el("h3", {}, title));
  if (v) box.append(el("ul", { class: "found" }, ...v.findings.map((f) => el("li", {}, sentence(f)))), el("div", { id: "closest", html: v.closest }), el("div", { html: v.cards }),
    ...v.core_measured.map((m) => el("p", { class: m.alarm ? "danger" : "" }, m.sentence)));
  for (const [id, title] of t ? TABLES.filter(([id]) => t[id]) : []) box.append(fold(id, `${title}: ${t.of}`, scroll(`${title}: ${t.of}`, t[id])));
}

// Of the step that is shown in full; that of the file has those of the refitted model, and their heads say so.
const TABLES = [["errors", "Errors by sensor"], ["parameters", "Parameters"], ["correlations", "Correlation of the parameters"], ["thermocouples", "Thermocouples in cores"]];

// How well the cores are known, and what speaks against them.
function core(c) {
  return c.sentence ? [el("p", { class: `core ${c.proven ? "" : "alarm"}` }, c.sentence), el("ul", { class: "found" }, ...c.why.map((t) => el("li", {}, sentence(t))))] : [];
}

function verdict() {
  const d = state.diagnosed;
  const box = $("panel-diagnose");
  const button = el("button", { class: d && !state.diagnosed_of ? "" : "main", type: "button", id: "diagnose", "data-work": true, "data-off": state.opened ? null : "1", onclick: diagnose },
    d ? "Diagnose again" : "What is missing?");
  box.replaceChildren(el("h2", {}, "Diagnose"));
  if (state.dropped) box.append(el("p", { class: "alarm" }, state.dropped));
  if (!d) { box.append(...none(state.opened ? "Searches the catalogue of effects for what explains the error; none is assumed." : NOTHING), button); return; }
  if (state.diagnosed_of) box.append(el("p", { class: "muted", id: "found-for" }, `Found for “${state.diagnosed_of}”, before what has been added since:`));
  // judged by the gate of adding for the model that was diagnosed; of a later model it knows nothing
  const free = state.diagnosed_of ? [] : (d.offer ?? []).filter((k) => !inModel(k));
  if (d.recalled) box.append(el("p", { class: "alarm", id: "recalled" }, "This diagnosis is taken from the session file and was not computed here: its verdict, its ranking and their words are as the file has them. The cores are computed here. ", computed("confirm")));
  box.append(el("p", {}, el("span", { class: `tag ${d.recalled ? "recalled" : d.verdict}` }, d.recalled ? `${d.tag}, by the session file` : d.tag)), el("p", { class: "verdict" }, d.sentence),
    d.not_offered ? el("p", { class: "alarm", id: "not-offered" }, d.not_offered) : "",
    free.length ? el("p", {}, el("button", { type: "button", class: "main", id: "add-named", "data-work": true, onclick: () => add(free) }, `Add ${labels(free)}${free.length > 1 ? " at once" : ""}`)) : "",
    ...core(d.core));
  const list = el("ul", { class: "effects" });
  let before = null;
  for (const [i, r] of d.ranking.entries()) {
    if (r.role + r.against !== before) list.append(el("li", {}, el("h3", {}, r.group), el("p", { class: "muted against" }, `Bars: ${r.against}.`)));
    before = r.role + r.against;
    list.append(effect(r, i, d));
  }
  if (d.ranking.length) box.append(el("p", { class: "muted" }, `Evidence as log-odds. Bars under one heading are weighed against the same model and have one scale, those under another heading have another; dashed: what an effect needs, 3 (20 to 1). ${d.recalled ? "Kept from the session: diagnose again to draw curves of effects." : "Point at an effect, or tap it, to draw its curve."}`), list);
  if (d.next) box.append(el("h3", {}, "What to measure next"), el("p", { id: "next" }, d.next));
  if (d.card.length) box.append(fold("card", "What these data could show at all", el("ul", {}, ...d.card.map((t) => el("li", {}, t)))));
  if (d.absorbed.length) box.append(fold("absorbed", "What a parameter absorbs", el("ul", {}, ...d.absorbed.map((t) => el("li", {}, t)))));
  box.append(button);
}

const inModel = (key) => state.steps.some((s) => s.words.some((w) => w === key || w === key.split(":")[0])) || state.opened?.effects.includes(key);

// A number in thousands and more, such as 2.0·10⁶.
const power = (x) => x.toExponential(1).replace(/e\+(\d+)$/, (_, digits) => `·10${[...digits].map((k) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[k]).join("")}`);

function effect(r, i, d) {
  const id = `effect-${i}`;
  const open = ui.open.includes(id);
  const odds = r.evidence === null ? "–" : (Math.abs(r.evidence) >= 1000 ? power(r.evidence) : r.evidence.toFixed(Math.abs(r.evidence) < 10 ? 1 : 0)).replace("-", "−");
  const point = () => { if (r.drawn) preview(r.name); };
  const leave = () => preview(null);
  const button = el("button", { type: "button", id, "aria-expanded": String(open), onmouseenter: point, onmouseleave: leave, onfocus: point, onblur: leave,
    onclick: () => {
      const rest = ui.open.filter((x) => x !== id);
      keep({ open: ui.open.includes(id) ? rest : [...rest, id] });
      verdict();
      settle();
      $(id)?.focus({ preventScroll: true });
    } },
    el("span", { class: "name" }, ...softly(named(r))),
    el("span", { class: "track" }, el("span", { class: "fill", style: `width:${100 * r.reach}%` }), el("span", { class: "need", style: `left:${100 * r.needs}%` })),
    el("span", { class: "odds" }, odds), el("span", { class: "aloud" }, ` log-odds${r.refused ? `, refused: ${r.refused}` : ""}`));
  const item = el("li", { class: `effect ${r.role}${r.refused ? " refused" : ""}` }, button);
  if (open) item.append(told(r, d));
  return item;
}

// In plain words first, the word of the catalogue in brackets.
const labels = (keys) => keys.map((k) => { const e = state.opened?.catalogue.find((x) => x.name === k.split(":")[0]); return e ? `${e.title} (${k})` : k; }).join(" and ");
const named = (r) => (r.effects.length ? r.effects.map((e) => `${e.title} (${e.key})`).join(" and ") : r.name);

function told(r, d) {
  const list = el("dl", {});
  const say = (term, text) => { if (text) list.append(el("dt", {}, term), el("dd", {}, text)); };
  say("Why not", sentence(r.refused));
  say(sentence(d.error), r.error_K === null ? "" : `${K(r.error_K)}${r.without_K === null ? "" : `; without it ${K(r.without_K)}`}`);
  say("Probability among what was compared", r.share === null ? "" : r.share > 0.995 ? "over 99 %" : r.share < 0.005 ? "under 1 %" : `${(100 * r.share).toFixed(0)} %`);
  say("Its numbers, ± 1 sd", r.numbers.join("; "));
  say("These data cannot tell it from", r.tied.join(", "));
  for (const e of r.effects) {
    list.append(el("dt", {}, "Equation"), el("dd", {}, el("pre", {}, e.equation)));
    say("How it shows", sentence(e.signature));
    say("Parameters", e.parameters.join("; "));
    say("Needs", sentence(e.needs));
    say("Looks like", e.confused_with.join(", "));
  }
  const keys = r.effects.map((e) => e.key).filter((k) => !inModel(k));
  const button = keys.length ? el("button", { type: "button", id: `add-${r.name}`, "data-work": true, onclick: () => add(keys) }, `Add ${labels(keys)}`) : el("span", { class: "muted" }, "It is in the model.");
  return el("div", { class: "told" }, list, button);
}

export function add(keys, force = false) {
  dispatchEvent(new CustomEvent("tab", { detail: "add" }));
  return work("add", { words: keys, force });
}

const KINDS = [["trained_K", "error where fitted"], ["held_K", "error held out"], ["core_K", "core, 95 % half width"]];

const unknown = (s) => s.stair?.core_known === false;

// The models so far, and behind them the one that is being fitted or was refused.
function steps() {
  const r = state.refusal ?? state.job?.trial;
  const all = state.steps.map((s) => ({ ...s, kind: s.worse ? "worse" : s.forced ? "forced" : s.core?.proven === false ? "unproven" : "" }));
  if (state.job?.trial) all.push({ name: `${r.step}, being fitted (closest fit so far)`, kind: "fitting", stair: state.job.trial.after });
  else if (r) all.push({ name: `${r.step} (not added)`, kind: "tried", stair: r.after });
  return all;
}

// One and the same too: its bars move to where they are to be from wherever they are.
const stairs = el("div", { class: "stairs" });
const barNames = el("p", { class: "muted", id: "bar-names" });
const barsWorse = el("p", { id: "bars-worse" });
const underStairs = el("div", {});

function climb() {
  const all = steps();
  const kinds = KINDS.filter(([kind]) => all.some((s) => s.stair?.[kind] > 0));
  const shape = JSON.stringify([kinds, all.length]);
  if (stairs.dataset.shape !== shape) { raise(kinds, all.length); stairs.dataset.shape = shape; }
  barNames.replaceChildren(...all.flatMap((s, j) => [j ? " · " : "", el("b", {}, `${j + 1}`), ` ${s.name}${s.core?.proven === false ? " (core not proven)" : ""}`]));
  barsWorse.replaceChildren(...all.filter((s) => s.worse).map((s) => el("b", { class: "danger worse" }, s.worse)));
  for (const [i, [kind, title]] of kinds.entries()) {
    // a core is judged when the fit has ended: what its band is on the way is no answer
    const later = all.map((s) => kind === "core_K" && s.kind === "fitting" && !unknown(s));
    const values = all.map((s, j) => (later[j] || (kind === "core_K" && unknown(s)) ? null : s.stair?.[kind] ?? null));
    const floor = kind === "core_K" ? null : all[0].stair?.floor_K;
    // a core that is not known stands as high as the picture, above all bands that are: no band looks wider than it
    const open = values.map((v, j) => v === null && kind === "core_K" && unknown(all[j]));
    const top = (Math.max(...values, floor ?? 0) || 1) * (open.includes(true) ? 1.25 : 1);
    const [caption, bars] = stairs.children[i].children;
    caption.textContent = `${title[0].toUpperCase()}${title.slice(1)}, K${floor ? `; dotted: noise alone, ${K(floor, 2)}` : kind === "core_K" ? `${all.some(unknown) ? "; ?: not known" : ""}${later.includes(true) ? "; …: judged when the fit has ended" : ""}` : ""}`;
    bars.setAttribute("aria-label", `${title}: ${values.map((v, j) => `${all[j].name} ${open[j] ? "not known" : later[j] ? "not judged yet" : K(v)}`).join(", ")}${floor ? `; noise ${K(floor)}` : ""}`);
    values.forEach((v, j) => {
      const bar = bars.children[j];
      bar.className = `bar ${all[j].kind}${open[j] ? " open" : ""}`;
      bar.lastChild.textContent = v !== null ? K(v, 2).replace(" K", "") : open[j] ? "?" : later[j] ? "…" : "–";
      bar.lastChild.classList.toggle("danger", v === null && kind === "core_K" && !later[j]);
      bar.style.setProperty("--c", colorOf(j));
      bar.style.setProperty("--h", `${open[j] ? 100 : v === null ? 0 : (100 * v) / top}%`);
    });
    bars.lastChild.style.bottom = `calc(${(floor ?? 0) / top} * (100% - 18px))`; // as .bars is padded
    bars.lastChild.hidden = !floor;
  }
}

// As many bars as there are models; those that stood before begin where they stood, a new one as high as its neighbour.
function raise(kinds, count) {
  const stood = [...stairs.children].map((f) => [...f.querySelectorAll(".bar")].map((bar) => bar.style.getPropertyValue("--h")));
  stairs.replaceChildren(...kinds.map((_, i) => {
    const bars = Array.from({ length: count }, (_, j) =>
      el("span", { class: "bar", style: `--h:${stood[i]?.[Math.min(j, stood[i].length - 1)] ?? "0%"}` }, el("i", {}), el("small", {}, `${j + 1}`), el("b", {})));
    return el("figure", {}, el("figcaption", {}), el("div", { class: "bars", role: "img" }, ...bars, el("span", { class: "floor" })));
  }));
  stairs.getBoundingClientRect(); // from here on changes move
}

export function trial(found) {
  if (!state || !found) return;
  const first = !state.job?.trial;
  state.job = { ...state.job, trial: found };
  if (first || stairs.hidden) { adding(); settle(); } else climb();
}

// One and the same, however often the panel is drawn anew: what is being typed into it stays.
const field = el("input", { id: "effect-name", list: "effect-names", autocomplete: "off", spellcheck: "false",
  onkeydown: (e) => { if (e.key === "Enter") chosenOne(); } });

function adding() {
  // the stairs stay in their place: what is taken out and put back does not move
  if (!stairs.isConnected) $("panel-add").replaceChildren(el("h2", {}, "Add"), stairs, barNames, barsWorse, underStairs);
  const box = underStairs;
  box.replaceChildren();
  stairs.hidden = barNames.hidden = barsWorse.hidden = !(state.steps.some((s) => s.words.length) || state.refusal || state.job?.trial);
  if (!state.steps.length) { box.append(...none(NOTHING)); return; }
  if (!stairs.hidden) climb();
  else box.append(el("p", { class: "muted" }, "Nothing is added yet. This place shows what an addition does to the errors, where fitted and where held out, and to the band of the core."));
  if (state.job?.trial) box.append(el("p", { class: "muted", id: "fitting-told" }, "Striped: how close a fit comes to the readings so far. In the end the bar stands at the error that is stated for the step: that of numbers which also hold to what was known before, so it may be larger."));
  const hatched = !stairs.hidden && state.steps.some((s) => s.core?.proven === false);
  if (hatched) box.append(el("p", { class: "muted", id: "hatched" }, el("i", { class: "line unproven", style: "--c:var(--after);display:inline-block" }), " Hatched: the surface may be better, the core is not proven."));
  const way = el("ol", { class: "way" });
  for (const s of state.steps) {
    const item = el("li", {}, s.forced ? el("b", { class: "alarm" }, s.name) : s.name);
    if (s.worse) item.append(el("br"), el("b", { class: "danger worse" }, s.worse));
    if (s.remains) item.append(el("br"), el("b", { class: "alarm" }, s.remains));
    if (s.told) {
      item.append(el("br"), s.told.headline);
      if (!s.told.core.proven) item.append(el("br"), el("b", { class: "alarm" }, `${s.told.tag}. ${s.told.core.sentence}`), ...s.told.core.why.flatMap((t) => [el("br"), t]));
      if (s.forced && s.told.core.proven) item.append(el("br"), el("span", { class: "alarm" }, `Though: ${s.told.refused}.`));
      if (s.told.remark) item.append(el("br"), el("span", { class: "muted" }, s.told.remark));
      if (s.told.closest) item.append(el("br"), el("span", { class: "muted" }, s.told.closest));
      for (const m of s.told.core_measured) item.append(el("br"), el("span", { class: m.alarm ? "danger" : "" }, `${m.sentence} Before: ${K(m.before_K)} off.`));
    }
    way.append(item);
  }
  box.append(way);
  const r = state.refusal;
  if (r) {
    box.append(el("div", { class: "told", id: "refusal" }, el("p", {}, el("span", { class: "tag refused" }, "Not added")), el("p", {}, `${r.names}: ${r.refused}.`),
      el("p", { class: "muted" }, r.headline),
      el("button", { type: "button", id: "force", "data-work": true, onclick: () => add(r.words, true) }, "Add it in spite of this, marked as forced")));
  }
  const found = state.diagnosed?.ranking.flatMap((x) => x.effects.map((e) => e.key)) ?? [];
  const catalogue = state.opened?.catalogue ?? [];
  const offered = [...new Set([...found, ...catalogue.map((e) => e.name)])].filter((k) => !inModel(k));
  box.append(el("label", { for: "effect-name" }, "An effect of the catalogue; EFFECT:CELL where it sits on one cell"),
    el("div", { class: "row" }, field,
      el("button", { type: "button", id: "add", class: "main", "data-work": true, onclick: chosenOne }, "Add")),
    el("datalist", { id: "effect-names" }, ...offered.map((k) => el("option", { value: k, label: catalogue.find((e) => e.name === k.split(":")[0])?.title }))),
    el("p", {}, el("button", { type: "button", id: "undo", "data-work": true, "data-off": r || state.steps.some((s) => s.words.length) ? null : "1", onclick: undo }, r ? "Discard the refused addition" : "Undo the last addition")));
  const last = state.steps.at(-1).told;
  if (last) box.append(fold("numbers", "Numbers of the newest model", scroll("numbers", last.parameters)));
}

function chosenOne() {
  const keys = field.value.trim().split(/[\s,]+/).filter(Boolean);
  if (!keys.length) { complain("name an effect of the catalogue, such as entropic_heat"); return; }
  add(keys);
}

const readyBox = el("span", { id: "report-ready", role: "status" });
const takeFiles = el("div", {}), takeLines = el("div", {});

function away() {
  const box = $("panel-take");
  if (!state.steps.length) { box.replaceChildren(el("h2", {}, "Take away"), ...none(NOTHING)); return; }
  if (!noteBox.isConnected) box.replaceChildren(el("h2", {}, "Take away"), takeFiles, noteBox, takeLines);
  noted(state.session?.notes ?? "");
  const name = state.config.match(/model = "(.*)"/)?.[1] ?? "model.toml";
  const url = (what) => `/api/take?${new URLSearchParams({ desk: ui.desk, what, name })}`;
  takeFiles.replaceChildren(
    el("p", {}, el("a", { href: url("model"), id: "take-model", download: name }, `Model file: ${name}`)),
    state.model_told ? el("p", { id: "take-model-told", class: "alarm" }, state.model_told) : "",
    el("p", {}, el("button", { type: "button", id: "take-report", "data-work": true, onclick: attempt(report) }, "HTML report of what is shown"), " ", readyBox, state.diagnosed?.recalled ? el("span", { class: "muted", id: "report-computes" }, " The diagnosis of the session file is computed again for it.") : ""),
    el("p", {}, el("a", { href: url("session"), id: "take-session", download: "session.json", onclick: withNotes }, "Session file: the names of the files, the steps and the notes, to go on later or elsewhere")));
  const file = (read) => `/api/take?${new URLSearchParams({ desk: ui.desk, what: "file", name: read })}`;
  takeLines.replaceChildren(
    el("h3", {}, "The same by commands"),
    ...(state.read.length ? [el("p", { id: "take-read" }, "They read these files, which lie with this tab: ", ...state.read.flatMap((read, k) => [k ? ", " : "", el("a", { href: file(read), download: read }, read)]), ". Save those that you do not have, and type the commands where they lie.")] : []),
    el("pre", { id: "commands" }, ...state.commands.flatMap(whole)),
    el("button", { type: "button", onclick: attempt(async () => navigator.clipboard.writeText(state.commands.join("\n"))) }, "Copy"),
    el("h3", {}, "In the gateway's config"), el("pre", { id: "config-lines" }, state.config),
    el("p", { class: "muted" }, "Put the model file beside the config; run and analyze then estimate with it."));
}

// A line of commands that is broken between words alone: "--model" stays whole.
const whole = (line, k) => [k ? "\n" : "", ...line.split(" ").flatMap((word, i) => [i ? " " : "", el("span", {}, word)])];

async function report() {
  readyBox.replaceChildren();
  await sent();
  const steps = ticked(state.steps).map((s) => state.steps.indexOf(s));
  const response = await fetch(`/api/take?${new URLSearchParams({ desk: ui.desk, what: "report", steps })}`);
  if (!response.ok) throw new Error((await response.json()).error);
  const href = URL.createObjectURL(await response.blob());
  // a browser saves only what a person has just asked for; a report may take longer than it remembers that
  const save = el("a", { href, download: "report.html" }, "It is made: save report.html");
  if (navigator.userActivation?.isActive ?? true) save.click(); else readyBox.replaceChildren(save);
  setTimeout(() => { URL.revokeObjectURL(href); if (save.isConnected) readyBox.replaceChildren(); }, 600000);
}
