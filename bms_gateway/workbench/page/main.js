// Starts the page: finds this tab's desk, listens for changes, steps and keys.
import { $, LOST, answers, get, post, upload, ui, keep, attempt, until, complain, fault, runs, sentence, claim as claimed, desked } from "./util.js";
import * as columns from "./open.js";
import * as kept from "./kept.js";
import * as plots from "./plots.js";
import * as measure from "./measure.js";
import * as road from "./road.js";
import * as live from "./live.js";
import { unsent } from "./notes.js";

const STEPS = ["open", "compare", "diagnose", "add", "take", "live"];
let version = -1;
let busy = null;
let fetching = false;
let stale = false;

function step(name, focus = false) {
  if (name === "live" && $("tab-live").hidden) name = "open";
  if (name !== ui.tab) { scrollTo(0, 0); $("panels").scrollTop = 0; }
  keep({ tab: name });
  document.body.dataset.tab = name;
  for (const s of STEPS) {
    const on = s === name;
    $(`tab-${s}`).setAttribute("aria-selected", String(on));
    $(`tab-${s}`).tabIndex = on ? 0 : -1;
    $(`panel-${s}`).hidden = !on;
    if (on && focus) $(`tab-${s}`).focus();
  }
  $("road").hidden = name === "live"; $("watch").hidden = name !== "live";
  live.listen(name === "live" && !document.hidden);
  plots.preview(null);
  if (name !== "live") dispatchEvent(new Event("resize"));
}

async function refresh() {
  if (fetching) { stale = true; return; }
  fetching = true;
  try {
    do {
      stale = false;
      const state = await get("state");
      const fresh = version !== state.version;
      version = state.version;
      job(state.job);
      fault(state.error);
      runs(state.job?.title);
      newest(state.job);
      road.show(state);
      if (!state.job?.trial) plots.trying(null);
      await plots.show(state, fresh);
      newest(state.job);
      plots.trying(state.job?.trial);
      document.body.dataset.version = version;
      document.body.dataset.busy = state.job ? state.job.kind : "";
    } while (stale);
  } catch (e) { complain(e.message); } finally { fetching = false; }
}

function job(j) {
  $("job").hidden = !j;
  if (!j) return;
  const title = sentence(j.title);
  if ($("job-title").textContent !== title) $("job-title").textContent = title;
  if (j.share > 0) $("job-share").value = j.share; else $("job-share").removeAttribute("value");
  $("job-text").textContent = j.text;
}

// What was fetched may be older than what was heard meanwhile: a fit on its way never goes back.
let told = null;
function newest(j) {
  if (j && told?.trial && told.kind === j.kind && told.title === j.title && told.share >= j.share) j.trial = told.trial;
}

function heard(news) {
  const kind = news.job?.kind ?? "";
  told = news.job ?? null;
  // progress alone changes the bar; everything else is fetched
  if (busy === kind && kind && news.job.share > 0) { job(news.job); road.trial(news.job.trial); plots.trying(news.job.trial); return; }
  busy = kind;
  if (news.version !== version) refresh();
}

// Only a tab that is looked at listens: a browser opens six connections to one server, for all of its tabs together.
let source = null;
function listen() {
  source?.close();
  source = null;
  if (document.hidden) return;
  source = new EventSource(`/api/events?${new URLSearchParams({ desk: ui.desk })}`);
  let lost = false;
  source.onmessage = (e) => {
    if (lost) { lost = false; complain(""); }
    heard(JSON.parse(e.data));
  };
  source.onerror = () => {
    if (source.readyState === EventSource.CLOSED) { again(); return; }
    lost = true;
    complain(LOST);
  };
}

// A duplicated tab brings the name of a desk along that is another tab's: it gets its own, and goes the same way there.
const ANSWER_MS = 150;
const tabs = new BroadcastChannel("desks");
async function alone() {
  if (ui.desk) {
    const taken = new Promise((done) => {
      tabs.onmessage = (e) => { if (e.data.taken === ui.desk) done(true); };
      setTimeout(() => done(false), ANSWER_MS);
    });
    tabs.postMessage({ asked: ui.desk });
    if (await taken) keep({ desk: "" });
  }
  tabs.onmessage = (e) => { if (e.data.asked && e.data.asked === ui.desk) tabs.postMessage({ taken: ui.desk }); };
}

// Looks for the desk until there is one: a program that ends answers still, and one that was ended may be started later.
const AGAIN_MS = 2000;
let looking = false;
async function again() {
  if (looking) return;
  looking = true;
  for (let found = false; !found;) {
    try {
      await until(claim);
      found = true;
    } catch (e) {
      complain(e.message);
      await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
  }
  looking = false;
  unsent();
  version = -1; // what was asked for meanwhile is fetched now
  listen();
  refresh();
}

// This tab's desk; a fresh one where there is none, or the program was started anew.
async function claim() {
  if (ui.desk) {
    try { await get("state"); answers(); return; } catch (e) { if (e.lost) throw e; /* a fresh one, below */ }
  }
  keep({ desk: (await post("desk")).desk });
  complain("");
  version = -1; // a desk counts its own changes
  // the program was started anew, or this tab is a duplicate: uploads are sent again, and the work goes its way again
  await kept.each((file) => upload(file, true)).catch((e) => complain(e.message));
  const anew = kept.changed().length > 0; // what was open cannot come back: the page says so
  if (ui.session && !anew) await road.resume(ui.session).catch((e) => complain(e.message));
  else if (Object.keys(ui.uploads).length) desked.then(columns.prepare); // chosen, and not opened yet
  road.unkept();
}

function keys(e) {
  if (e.ctrlKey || e.metaKey || e.altKey || e.defaultPrevented) return;
  const typing = e.target.closest("input:not([type=radio], [type=checkbox], [type=range]), textarea, select") || (e.target.type === "range" && e.key.startsWith("Arrow"));
  if (e.key === "Escape") { if (road.busy()) road.work("cancel"); complain(""); return; }
  if (typing) return;
  if (e.target.role === "tab" && ["ArrowLeft", "ArrowRight"].includes(e.key)) {
    const there = STEPS.filter((s) => !$(`tab-${s}`).hidden);
    const i = there.indexOf(ui.tab) + (e.key === "ArrowRight" ? 1 : -1);
    step(there[(i + there.length) % there.length], true);
  } else if (e.key >= "1" && e.key <= "6") step(STEPS[Number(e.key) - 1], true);
  else if (e.key === "ArrowLeft" && !e.target.closest("[role=radio], [type=radio]")) plots.pick(ui.cell - 1);
  else if (e.key === "ArrowRight" && !e.target.closest("[role=radio], [type=radio]")) plots.pick(ui.cell + 1);
  else if (e.key === "d") { step("diagnose"); road.diagnose(); }
  else if (e.key === "u") { step("add"); road.undo(); }
  else if (e.key === "t") theme();
  else if (e.key === "c" && !$("shown").hidden) { if (["open", "live"].includes(ui.tab)) step("compare"); measure.toggle(); }
  else return;
  e.preventDefault();
}

function theme() {
  const to = plots.dark() ? "light" : "dark";
  document.documentElement.dataset.theme = to;
  localStorage.setItem("theme", to);
  $("theme").textContent = to === "dark" ? "Light" : "Dark";
  plots.redraw();
}

async function start() {
  $("theme").textContent = plots.dark() ? "Light" : "Dark";
  $("theme").addEventListener("click", theme);
  $("keys").addEventListener("click", () => {
    $("key-list").hidden = !$("key-list").hidden;
    $("keys").setAttribute("aria-expanded", String(!$("key-list").hidden));
  });
  $("dismiss").addEventListener("click", () => complain(""));
  $("cancel").addEventListener("click", () => road.work("cancel"));
  for (const s of STEPS) $(`tab-${s}`).addEventListener("click", () => step(s));
  addEventListener("busy", refresh);
  addEventListener("tab", (e) => step(e.detail, !document.activeElement?.closest(`#panel-${e.detail}`))); // what was pressed may go away
  addEventListener("keydown", keys);
  document.addEventListener("visibilitychange", () => { live.listen(ui.tab === "live" && !document.hidden); listen(); });
  new ResizeObserver(() => document.documentElement.style.setProperty("--top", `${$("top").offsetHeight}px`)).observe($("top"));
  road.prepare();
  const [site] = await Promise.all([get("site"), alone().then(claim)]);
  claimed();
  addEventListener("lost", () => setTimeout(again, AGAIN_MS));
  if (site.watch) live.prepare(site.watch, site.grafana);
  const given = sessionStorage.getItem("seen");
  sessionStorage.setItem("seen", "1");
  step(site.watch && !given ? "live" : ui.tab);
  if (!document.hidden) refresh(); // not only when the first event comes
  listen();
}

attempt(start)();
