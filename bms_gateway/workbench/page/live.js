// The live pack: cells coloured by their core, what is flagged in words, sensors, bus; or a log that is played.
import { $, LOST, el, post, attempt, complain, counted, clock, fixed, many, moment, plain, sentence, wallMs, when, wide } from "./util.js";
import * as past from "./past.js";

// Cividis, told apart with any common colour blindness, dark to light as the hottest point of the cell gets hotter.
const SCALE = [[0, 34, 78], [53, 69, 108], [102, 105, 112], [148, 142, 119], [200, 184, 102], [254, 232, 56]];
const SVG = "http://www.w3.org/2000/svg";
// The scale ends at the limit of the cores and does not move; near the limit and over it cells have colours of their own.
const BELOW_K = 50, NEAR_K = 10;
const OLD_S = 3; // s, age from which a reading is not of now
const NEAR = [255, 152, 56], OVER = [176, 0, 32];
let about = null;
let view = "";
let rows = [];
let source = null;
let sliding = false;
export let pictures = 0;

const degrees = (x) => (x === null ? "–" : fixed(x, 1));
const band = (half) => (half === null ? "" : ` ± ${half.toFixed(1)}`);
// A hottest point as the alarms tell it: a band that reaches below all that is possible says nothing.
const point = (x, half) => {
  const { K, unknown_95: wide } = about.available;
  if (x === null) return "not known";
  if (half > 2 * wide) return `not known to ${2 * K} K`;
  return half > wide ? `about ${fixed(x, 0)} °C, not known to ${K} K` : `${degrees(x)}${band(half)} °C`;
};
const steer = (wish) => attempt(() => post("watch", { view, ...wish }))();

const PLAY = { Play: { play: true }, Pause: { play: false }, "Play again": { play: true, seek: 0 } };

export function prepare(known, grafana) {
  about = known;
  view = sessionStorage.getItem("view") || about.view;
  sessionStorage.setItem("view", view);
  $("tab-live").hidden = false;
  const log = about.kind === "log";
  const controls = el("div", { id: "live-head" },
    el("h2", {}, log ? `Playing ${about.title}` : `Live on ${about.title}`),
    el("button", { type: "button", id: "play", onclick: () => steer(PLAY[$("play").textContent]) }, "Pause"),
    el("span", {}, el("label", { for: "speed" }, "Speed "), el("select", { id: "speed", onchange: (e) => steer({ speed: Number(e.target.value) }) },
      ...about.speeds.map((s) => el("option", { value: s }, `${s}×`)))),
    el("label", { for: "time" }, "Time"),
    el("input", { type: "range", id: "time", min: 0, max: 1, step: 1, value: 0,
      onpointerdown: () => { sliding = true; }, onpointerup: () => { sliding = false; },
      oninput: (e) => { $("at").textContent = newest ? when(newest, Number(e.target.value)) : ""; steer({ seek: Number(e.target.value) }); } }),
    el("output", { id: "at", for: "time" }, "0:00:00"),
    log ? "" : el("button", { type: "button", id: "follow", onclick: () => steer({ follow: true }) }, "Now"));
  const limit = about.limits.core_C;
  const facts = el("dl", { id: "live-bus" }, ...["hottest", "bus", "refused", "model"].map((id) =>
    el("div", { class: "card" }, el("dt", { id: `${id}-title` }, ""), el("dd", { class: "value words", id: `${id}-value` }, "–"), el("dd", { id: `${id}-line` }, ""))));
  rows = about.strings.map((s) => string(s));
  $("panel-live").append(controls, el("section", { id: "banner", "aria-label": "Alerts", hidden: true }, el("h3", { id: "banner-title", role: "alert" }), el("ul", { id: "banner-list" })), el("p", { id: "live-state", role: "status", class: "muted" }, "Waiting for frames…"), facts,
    el("p", { class: "muted", id: "live-key" }, "Cell, core in °C, ± 95 % half width in K, as all bands here; coolant flows from left to right. Colour: the hottest point inside the cell, ",
      `${plain(limit - BELOW_K)} °C `, el("span", { class: "scale", id: "scale" }), ` ${plain(limit - NEAR_K)} °C · `,
      el("span", { class: "patch", style: `background:rgb(${NEAR})` }), ` from ${plain(limit - NEAR_K)} °C · `, el("span", { class: "patch", style: `background:rgb(${OVER})` }), ` limit ${plain(limit)} °C and over`,
      ` · Not known: the last reading of its surface stands below, with its age, and gives the colour from ${plain(NEAR_K)} K below the limit of surfaces on · Dashed: no sensor of its own · dotted, ?: core not proven · double frame: its sensor is not used · hatched: an old value · ring: hottest point · pale in a dashed frame: nothing new (stale) · grey in a frame: the bus is silent (parked)`),
    ...rows.map((r) => r.node), past.build(about, view, (t) => steer({ seek: t }), grafana), happened());
  $("scale").style.background = `linear-gradient(to right, ${SCALE.map((c) => `rgb(${c})`).join(",")})`;
}

function string(s) {
  const told = el("p", { class: "ahead", role: "status" });
  const cells = Array.from({ length: s.cells }, (_, k) => {
    const parts = { core: document.createTextNode("–"), half: document.createTextNode(""), read: document.createTextNode("") };
    const node = el("button", { type: "button", class: "live-cell", onclick: () => { told.picked = k; put(told, cells[k].node.title); } }, el("small", {}, `${k + 1}`), el("b", {}, parts.core), el("span", {}, parts.half), el("span", { class: "read" }, parts.read));
    return { node, ...parts, k, last: "" };
  });
  const hottest = el("p", {}), ahead = el("p", { class: "ahead muted" }), resistance = el("p", {}), words = el("p", {}), heat = el("p", {}), trend = document.createElementNS(SVG, "svg");
  trend.setAttribute("width", 240); trend.setAttribute("height", 34); trend.setAttribute("role", "img");
  const node = el("div", { class: "live-string" }, el("div", {}, el("b", {}, s.name), hottest), el("div", { class: "live-cells", role: "group", "aria-label": `cells of ${s.name}` }, ...cells.map((c) => c.node)),
    el("div", { class: "live-facts" }, resistance, trend, heat, words), ahead, told);
  return { node, told, cells, hottest, ahead, resistance, trend, heat, words, sensors: new Set(s.sensors), trended: "" };
}

// Listens while the page is looked at; a hidden page costs nothing.
export function listen(on) {
  if (!about || Boolean(source) === on) return;
  if (!on) { source.close(); source = null; return; }
  source = new EventSource(`/api/watch?${new URLSearchParams({ view })}`);
  source.onmessage = (e) => { complainOnce(false); picture(JSON.parse(e.data)); };
  source.onerror = () => complainOnce(true);
}
let gone = false;
function complainOnce(now) {
  if (now !== gone) complain(now ? LOST : "");
  if (now && newest) { // what is shown is old from now on, whatever it says
    for (const r of rows) r.node.className = "live-string parked";
    put($("live-state"), `The workbench does not answer: what is shown is of ${when(newest, newest.at)}, and may be long past.`);
  }
  gone = now;
}

const put = (node, text) => { if (node.textContent !== text) node.textContent = text; };

function picture(p) {
  pictures += 1;
  $("panel-live").dataset.pictures = pictures;
  put($("live-state"), p.problem || condition(p));
  if (!p.ticks) return;
  if (!sliding) { $("time").max = Math.max(p.last, p.at); $("time").value = p.at; put($("at"), `${when(p, p.at)} of ${when(p, p.last, wallMs(p, p.at))}`); $("at").dataset.s = p.at; }
  $("time").setAttribute("aria-valuetext", when(p, p.at));
  const over = about.kind === "log" && p.playing && p.last > 0 && p.at >= p.last;
  put($("play"), over ? "Play again" : p.playing ? "Pause" : "Play");
  if (document.activeElement !== $("speed")) $("speed").value = p.speed;
  if ($("follow")) $("follow").disabled = p.following;
  banner(p);
  let hot = null;
  const worse = []; // may be hotter than all that is known
  const dark = p.strings.reduce((n, s) => n + s.core.filter((x) => x === null).length, 0);
  p.strings.forEach((s, i) => {
    const burning = inHeat(p, about.strings[i].name).filter((k) => s.core[k] === null);
    if (burning.length) worse.push(`${burning.length > 1 ? "cells" : "cell"} ${counted(burning.map((k) => k + 1))} of ${about.strings[i].name}`);
    row(rows[i], s, p.state, burning);
    if (s.hottest !== null && (hot === null || s.centre[s.hottest] > hot.centre)) hot = { string: about.strings[i].name, cell: s.hottest + 1, core: s.core[s.hottest], half: s.half[s.hottest], centre: s.centre[s.hottest], within: s.centre_half[s.hottest] };
  });
  card("hottest", "Hottest point", worse.length ? "not known" : hot ? point(hot.centre, hot.within) : "not available", worse.length ? `In alarm and not known: ${worse.join(", ")}${hot ? `; hottest of the others: ${point(hot.centre, hot.within)} (${hot.string}, cell ${hot.cell})` : ""}` : hot ? `${hot.string}, cell ${hot.cell}; its core, the mean of the roll: ${hot.core.toFixed(1)} ± ${hot.half.toFixed(1)} °C${dark ? `; ${many(dark, "cell")} not known` : ""}` : "");
  const b = p.bus;
  card("bus", "Bus load", b.load === null ? "–" : `${b.load.toFixed(1)} % of ${about.bitrate / 1000} kbit/s`, `${b.per_s ?? "–"} ${b.per_s === 1 ? "frame" : "frames"}/s, ${b.received} in all, ${b.dropped} lost; stuff bits not counted`);
  const refused = Object.entries(b.refused).filter(([, n]) => n);
  card("refused", "Samples not used", String(refused.reduce((a, [, n]) => a + n, 0)), refused.map(([why, n]) => `${n}: ${why}`).join("; ") || "All that came are used.");
  const worst = p.strings.reduce((a, s, i) => (s.mismatch !== null && (a === null || s.mismatch > a.m) ? { m: s.mismatch, name: about.strings[i].name } : a), null);
  card("model", "Model mismatch", worst ? `${worst.m.toFixed(2)} × its band` : "–", worst ? `${worst.name}; 1 is as it should be, from 2 on suspected` : "");
  events(p);
  past.follow(p);
}

function condition(p) {
  if (!p.ticks) return `Waiting for frames; the interface is ${p.link}.`;
  if (about.kind === "log" && !p.whole) return "Still reading the log.";
  if (about.kind === "live" && p.following && p.bus.link !== "up") return `The interface is ${p.bus.link}.`;
  if (p.state === "stale") return `Stale: nothing new for ${Math.round(p.silent)} s.`;
  return p.state === "parked" ? `Parked: the bus has been silent for ${clock(p.silent)}; the last estimates are shown.` : "";
}

// What is wrong at the moment that is shown, the gravest first; and that what is shown is old.
function banner(p) {
  const alarms = p.alerts.filter((a) => a.level === "alarm").length, warnings = p.alerts.length - alarms;
  const count = (n, word) => (n ? [many(n, word)] : []);
  $("banner").hidden = !p.alerts.length;
  $("banner").className = alarms ? "alarms" : "warnings";
  put($("banner-title"), [...count(alarms, "alarm"), ...count(warnings, "warning")].join(", "));
  const told = JSON.stringify(p.alerts);
  if ($("banner-list").dataset.told === told) return;
  $("banner-list").dataset.told = told;
  const item = (a) => el("li", { class: a.level }, el("b", {}, `${a.level === "alarm" ? "Alarm" : "Warning"}${a.string ? `, ${a.string}` : ""}: `), a.text);
  const [first, rest] = [p.alerts.slice(0, 3), p.alerts.slice(3)];
  const open = $("banner-list").querySelector("details")?.open ?? false;
  $("banner-list").replaceChildren(...first.map(item), ...(rest.length ? [el("li", {}, el("details", { open }, el("summary", {}, `and ${rest.length} more`), el("ul", {}, ...rest.map(item))))] : []));
}

let newest = null;
function happened() {
  const choice = (id, label, options) => [el("label", { for: id }, `${label} `), el("select", { id, onchange: () => newest && events(newest, true) }, ...options.map(([v, t]) => el("option", { value: v }, t)))];
  return el("section", { "aria-label": "Events" }, el("div", { class: "heads" }, el("h3", {}, "What happened"),
    ...choice("event-level", "Show", [["", "all"], ["warning", "warnings and alarms"], ["alarm", "alarms"]]),
    ...choice("event-seen", "which are", [["", "seen or not"], ["new", "not yet acknowledged"]]),
    ...choice("event-string", "of", [["", "all strings"], ...about.strings.map((s) => [s.name, s.name])]),
    el("a", { class: "file", id: "export-events", href: "/api/happened", download: "events.csv" }, "Export events (CSV)")),
    el("p", { class: "muted" }, "To acknowledge marks an event as seen on this page, for all who look at it; if it comes again, it is new again. The alarms of the running service end by: bms-gateway acknowledge STRING --reason TEXT."),
    wide(el("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "table of events" }, el("table", { id: "events" }))));
}

function events(p, again = false) {
  newest = p;
  const level = $("event-level").value, string = $("event-string").value;
  const list = p.events.filter((e) => (!string || e.string === string) && (!level || e.worst === "alarm" || e.worst === level) && (!$("event-seen").value || !e.seen));
  const told = JSON.stringify(list);
  if (!again && $("events").dataset.told === told) return;
  $("events").dataset.told = told;
  const head = el("thead", {}, el("tr", {}, ...["Last", "First", "Times", "Level", "String", "What", "Seen"].map((t) => el("th", { scope: "col" }, t))));
  $("events").replaceChildren(head, el("tbody", {}, ...(list.length ? list.map((e) => el("tr", { class: e.level, onclick: (click) => { if (!click.target.closest("button")) go(e); } },
    el("td", {}, el("button", { type: "button", class: "go", title: "Show this moment", onclick: () => go(e) }, when(p, e.at))), el("td", {}, e.count > 1 ? when(p, e.first) : ""), el("td", { class: "n" }, e.count > 1 ? `${e.count} ×` : ""),
    el("td", {}, el("b", {}, e.level === "note" ? "" : e.level), e.state === "over" ? " over" : ""), el("td", {}, e.string), el("td", {}, e.text), el("td", {}, seen(e))))
    : [el("tr", {}, el("td", { colspan: 7 }, "Nothing so far."))])));
}

// To the moment of an event, which is told to a tenth of a second.
const go = (e) => steer({ seek: e.at + 0.05 });

// Who has looked at it, and when; or the button to say so.
function seen(e) {
  if (e.seen) return el("span", { class: "muted" }, `${moment(e.seen.wall_ms)}${e.seen.reason ? `: ${e.seen.reason}` : ""}`);
  return el("button", { type: "button", class: "acknowledge", "aria-label": `Acknowledge: ${e.text}`, onclick: attempt(async () => {
    const reason = prompt("What was checked? (may be empty)");
    if (reason === null) return;
    await post("acknowledge", { view, code: e.code, part: e.part, string: e.string, alert: e.alert, reason });
  }) }, "Acknowledge");
}

function card(id, title, value, line) {
  put($(`${id}-title`), title); put($(`${id}-value`), value); put($(`${id}-line`), line);
}

// Whether it is the core that is not known: a core is known, too, where only its sensor's reading is not available.
const unknownCore = (s, k) => about.words[s.quality[k]] === "not available" && s.core[k] === null;

// Cells (from 0) of a string with an alarm of heat.
const inHeat = (p, string) => [...new Set(p.alerts.filter((a) => a.level === "alarm" && a.string === string && a.cell && ["core", "surface", "runaway", "lost_in_heat"].includes(a.code)).map((a) => a.cell - 1))].sort((a, b) => a - b);

function row(r, s, state, burning) {
  r.node.className = `live-string ${state}`;
  const limit = about.limits.core_C;
  for (const c of r.cells) {
    const core = s.core[c.k], half = s.half[c.k], q = s.quality[c.k], centre = s.centre[c.k];
    const unknown = unknownCore(s, c.k);
    // a core that is not known hides no surface: its last reading, with its age where it is not new
    const [read, age] = s.read?.[c.k] ?? [null, 0], old = age > OLD_S ? `${age < 120 ? `${Math.round(age)} s` : clock(age)} ago` : "";
    const now = `${core}|${half}|${centre}|${s.centre_half[c.k]}|${q}|${s.hottest === c.k}|${read}|${old}|${burning.includes(c.k)}`;
    if (c.last === now) continue;
    c.last = now;
    const word = about.words[q], warm = read === null ? -Infinity : read - about.limits.surface_C + limit; // as far below its own limit
    const hottest = Math.max(core ?? -Infinity, centre ?? -Infinity, warm, burning.includes(c.k) ? limit : -Infinity);
    put(c.read, read === null ? "" : `surface ${degrees(read)}${old && `, ${old}`}`);
    put(c.core, degrees(core)); put(c.half, unknown ? "not known" : half === null ? (word === "good" ? "" : word) : `${word === "doubtful" ? "? " : ""}± ${half.toFixed(1)}`);
    const [red, green, blue] = core === null && hottest < limit - NEAR_K ? [255, 255, 255] : hottest >= limit ? OVER : hottest >= limit - NEAR_K ? NEAR : mixed((hottest - limit + BELOW_K) / (BELOW_K - NEAR_K));
    c.node.style.background = `rgb(${red},${green},${blue})`;
    c.node.style.color = 0.3 * red + 0.59 * green + 0.11 * blue > 117 ? "#000" : "#fff";
    c.node.className = `live-cell ${["estimated", "doubtful"].includes(word) ? word : word === "good" || unknown ? "" : `bad ${word.replaceAll(" ", "-")}`}${s.hottest === c.k ? " hottest" : ""}${hottest >= limit ? " over" : ""}`;
    c.node.title = `Cell ${c.k + 1}: ${unknown ? `core not known to ${about.available.K} K (1 sd)` : `${word} (${about.why[q] ?? ""})`}; surface ${read === null ? degrees(s.surface[c.k]) : `read ${degrees(read)}`} °C${old && `, ${old}`}${warm >= limit ? `, at or over its limit of ${plain(about.limits.surface_C)} °C` : ""}${burning.includes(c.k) ? ", in alarm" : ""}; hottest point ${point(centre, s.centre_half[c.k])}${Math.max(core ?? -Infinity, centre ?? -Infinity) >= limit ? `, at or over its limit of ${plain(limit)} °C` : ""} (the colour is that of the hottest point)`;
  }
  if (r.told.picked !== undefined) put(r.told, r.cells[r.told.picked].node.title);
  const unknown = s.core.flatMap((x, k) => (x === null ? [k + 1] : [])); // one of them may be hotter
  put(r.hottest, s.hottest === null ? "No core known" : `${burning.length ? "Hottest of those that are known" : "Hottest"}: cell ${s.hottest + 1}, core ${degrees(s.core[s.hottest])}${band(s.half[s.hottest])} °C, hottest point ${point(s.centre[s.hottest], s.centre_half[s.hottest])}${unknown.length ? `; not known: cell${unknown.length > 1 ? "s" : ""} ${counted(unknown)}` : ""}`);
  const f = s.ahead, tight = f ? f.limiting - 1 : 0;
  put(r.ahead, f ? `Forecast at ${Math.abs(f.load_A ?? 0).toFixed(0)} A${f.load_A < 0 ? " charging" : ""}: hottest point in 1, 5, 10 min ${f.point.map((x, i) => (x === null ? "not known" : `${degrees(x)} ± ${f.half[i].toFixed(1)}`)).join(", ")} °C (cell ${f.cell})${f.limit_s ? (f.limit_s[1] > 0 ? `; cell ${f.limit_s[0]} reaches its limit in ${f.limit_s[1]} s` : "; the limit is reached") : ""}${f.discharge[2] || f.charge[2] ? `; ${f.discharge[2]} A discharging or ${f.charge[2]} A charging can be held for 10 min, limited by cell ${f.limiting}` : `; no current keeps every hottest point, with its band, below the limit of ${plain(limit)} °C for 10 min: cell ${f.limiting}, now ${point(s.centre[tight], s.centre_half[tight])}, ${s.centre[tight] >= limit ? "is over it" : "may be over it without a load"}`}` : "");
  put(r.resistance, s.R_e ? `Internal resistance (R_e) ${s.R_e[0].toFixed(2)} ± ${s.R_e[1].toFixed(2)} mΩ, ${s.R_e[2]}${s.growth === null ? "" : `; ${s.growth > 0 ? "+" : ""}${fixed(s.growth, 1)} % since commissioning`}` : "");
  const by = new Map();
  s.quality.forEach((q, k) => { const w = about.words[q]; if (r.sensors.has(k + 1) && w !== "good" && w !== "doubtful" && !unknownCore(s, k)) by.set(w, [...(by.get(w) ?? []), k + 1]); });
  const bad = [...by].map(([w, k]) => (k.length > 1 ? `sensors ${counted(k)} are ${w}` : `sensor ${k[0]} is ${w}`));
  if (s.quality.some((_, k) => unknownCore(s, k))) bad.unshift(`${unknown.length > 1 ? "cores" : "core"} of cell${unknown.length > 1 ? "s" : ""} ${counted(unknown)} not known`);
  if (s.quality.some((q) => about.words[q] === "doubtful")) bad.unshift("core not proven");
  put(r.heat, s.heat ? `Heat that no current makes: ${fixed(s.heat[1], 2)} ± ${s.heat[2].toFixed(2)} W in cell ${s.heat[0]}` : "");
  const flags = s.flags.map((f) => f.replaceAll("_", " ").replace(/:(\d+)$/, " of cell $1"));
  const alerts = s.words.length ? [`${many(s.words.length, "alert")}, see above`] : [];
  put(r.words, sentence([...alerts, flags.length ? flags.join(", ") : "no health flag", ...bad].join("; ")));
  r.words.className = s.words.length || s.flags.length || bad.length ? "alarm" : "";
  const told = JSON.stringify(s.trend);
  if (told !== r.trended) { r.trended = told; trend(r.trend, s.trend); }
}

function mixed(share) {
  const at = Math.min(Math.max(share, 0), 1) * (SCALE.length - 1), i = Math.min(Math.floor(at), SCALE.length - 2);
  return SCALE[i].map((c, j) => Math.round(c + (SCALE[i + 1][j] - c) * (at - i)));
}

function trend(svg, points) {
  svg.replaceChildren();
  const usable = points.filter(([, R, sd]) => R !== null && sd !== null);
  svg.setAttribute("aria-label", usable.length ? `trend of the internal resistance (R_e), from ${usable[0][1].toFixed(2)} to ${usable.at(-1)[1].toFixed(2)} milliohm` : "no trend of the internal resistance (R_e) yet");
  if (usable.length < 2) return;
  const t0 = usable[0][0], t1 = usable.at(-1)[0];
  const low = Math.min(...usable.map(([, R, sd]) => R - sd)), high = Math.max(...usable.map(([, R, sd]) => R + sd));
  const x = (t) => 2 + (236 * (t - t0)) / (t1 - t0 || 1), y = (R) => 32 - (30 * (R - low)) / (high - low || 1);
  const shape = (tag, more) => { const n = document.createElementNS(SVG, tag); for (const [k, v] of Object.entries(more)) n.setAttribute(k, v); svg.append(n); };
  const edge = (sign) => usable.map(([t, R, sd]) => `${x(t)},${y(R + sign * sd)}`);
  shape("polygon", { points: [...edge(1), ...edge(-1).reverse()].join(" "), fill: "var(--after)", "fill-opacity": 0.2 });
  shape("polyline", { points: usable.map(([t, R]) => `${x(t)},${y(R)}`).join(" "), fill: "none", stroke: "var(--after)", "stroke-width": 2 });
}
