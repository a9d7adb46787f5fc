// Two cursors with their difference, and statistics of the window: the server reckons both from every sample.
import { $, el, get, ui, keep, complain, afterwards, wide } from "./util.js";

const AFTER_MS = 80; // of the last move, the values are asked for
const STEPS = 400; // of a slider
const GRIP_PX = 7;
const INK = "#1a1a1a";
let shown = null; // what the plots show: names, window, unit with how many of it are one of the window's, steps, query, nodes
let asked = 0;

export const on = () => $("measure").open;
const at = (k) => ui.cursors?.[k];

// The lines of both cursors, to be drawn above what a figure has; they can be dragged.
export const lines = () => (on() && shown && ui.cursors ? ["a", "b"].map((k) => ({
  type: "line", xref: "x", yref: "paper", x0: at(k), x1: at(k), y0: 0, y1: 1, name: `cursor ${k}`,
  line: { color: INK, width: 1.6, dash: k === "a" ? "solid" : "dash" },
  label: { text: k.toUpperCase(), textposition: "end", textangle: 0, xanchor: "left", yanchor: "top", font: { size: 11, color: INK } } })) : []);

// The cursor whose line is near a place in a figure, and the figure's time there.
function under(node, e) {
  const axis = node._fullLayout?.xaxis, left = node.getBoundingClientRect().left + (axis?._offset ?? 0);
  if (!on() || !ui.cursors || !axis) return null;
  const per = Number(node.dataset.per || 1), x = e.clientX - left;
  const [k, off] = ["a", "b"].map((c) => [c, Math.abs(axis.d2p(at(c) * per) - x)]).sort((p, q) => p[1] - q[1])[0];
  return { k: off <= GRIP_PX && x >= 0 && x <= axis._length ? k : null, time: axis.p2d(x) / per };
}

// Lets the lines be dragged in a figure, by mouse and by finger.
export function grips(node) {
  let held = null;
  node.addEventListener("pointermove", (e) => {
    const found = held ? null : under(node, e);
    node.classList.toggle("grip", Boolean(held ?? found?.k));
    if (!held) return;
    const [first, last] = shown.window;
    move(held, Math.min(Math.max(under(node, e).time, first), last));
  });
  node.addEventListener("pointerdown", (e) => {
    held = under(node, e)?.k ?? null;
    if (!held) return;
    e.preventDefault(); // the plot would zoom
    e.stopPropagation();
    node.setPointerCapture(e.pointerId);
  }, true);
  for (const end of ["pointerup", "pointercancel"]) node.addEventListener(end, () => { held = null; });
}

function move(k, x) {
  keep({ cursors: { ...ui.cursors, [k]: x } });
  fields();
  shown.redraw();
  ask();
}

// Both into the window, at a third and at two thirds of it.
function gather() {
  const [first, last] = shown.window;
  keep({ cursors: { a: first + (last - first) / 3, b: first + (2 * (last - first)) / 3 } });
}

// What the plots show now; called whenever that has changed.
export function follow(next) {
  const other = shown?.record !== next.record;
  shown = next;
  if (!on()) return;
  if (!ui.cursors || (other && (at("a") > next.whole[1] || at("b") > next.whole[1]))) gather();
  fields();
  ask();
}

const digits = () => Math.max(0, Math.min(6, 3 - Math.floor(Math.log10((shown.window[1] - shown.window[0]) * shown.per || 1))));

function fields() {
  const [first, last] = shown.window;
  for (const k of ["a", "b"]) {
    const slider = $(`cursor-${k}`), text = $(`cursor-${k}-at`);
    Object.assign(slider, { min: first, max: last, step: (last - first) / STEPS });
    slider.value = at(k);
    slider.setAttribute("aria-valuetext", `${(at(k) * shown.per).toFixed(digits())} ${shown.unit}`);
    if (document.activeElement !== text) text.value = (at(k) * shown.per).toFixed(digits());
  }
  const apart = (at("b") - at("a")) * shown.per, s = apart * shown.seconds;
  $("cursor-apart").textContent = `B − A: ${plain(apart)} ${shown.unit}${Math.abs(s) < 600 && shown.unit !== "s" ? ` = ${plain(s)} s` : ""}`;
}

export const plain = (x, size = 5) => (x === null || x === undefined ? "–" : Object.is(x, -0) || x === 0 ? "0"
  : (Math.abs(x) >= 1e6 || Math.abs(x) < 1e-4 ? x.toExponential(3) : String(Number(x.toPrecision(size)))).replaceAll("-", "−"));

const ask = afterwards(AFTER_MS, async () => {
  const mine = ++asked;
  const { window: [from, to], names, query } = shown, { a, b } = ui.cursors;
  try {
    const { curves } = await get("measures", { names: names.join(), from, to, a, b, ...query });
    if (mine === asked) table(curves, [from, to], [a, b]);
  } catch (e) { complain(e.message); }
});

const heads = () => ["Curve", "at A", "at B", "B − A", `slope per ${shown.unit}`, "least", "greatest", "mean", "rms", "samples"];

// The values with the window and the cursors that they are of: both may have moved on meanwhile.
function table(curves, window, places) {
  const rows = curves.filter((c) => !c.step || shown.steps.includes(c.step)).map((c) => {
    const both = c.a !== null && c.b !== null, apart = (places[1] - places[0]) * shown.per;
    const size = Math.floor(Math.log10(Math.max(Math.abs(c.min), Math.abs(c.max)) || 1));
    const fixed = (x) => (x === null ? "–" : size > 5 || size < -3 ? plain(x) : x.toFixed(Math.min(Math.max(4 - size, 0), 6)).replace(/^-(?=.*[1-9])/, "−").replace(/^-/, ""));
    const cells = [c.a, c.b, both ? c.b - c.a : null].map(fixed);
    const slope = both && apart ? plain((c.b - c.a) / apart, 3) : "–";
    return el("tr", {}, el("th", { scope: "row" }, `${c.name}${c.unit ? `, ${c.unit}` : ""}`),
      ...[...cells, slope, ...[c.min, c.max, c.mean, c.rms].map(fixed), String(c.count)].map((t) => el("td", { class: "n" }, t)));
  });
  $("measures").replaceChildren(el("table", {}, el("thead", {}, el("tr", {}, ...heads().map((t) => el("th", { scope: "col", class: t === "Curve" ? null : "n" }, t)))), el("tbody", {}, ...rows)));
  wide($("measures")); // its table is another one
  $("measures").dataset.window = window.join();
  $("measures").dataset.cursors = places.join();
}

// Opens or closes; from the keyboard the first cursor is in hand at once.
export function toggle() {
  $("measure").open = !on();
  if (on()) { $("measure").scrollIntoView({ block: "nearest" }); $("cursor-a").focus(); }
}

export function prepare(redraw) {
  wide($("measures"));
  $("measure").addEventListener("toggle", () => {
    keep({ measuring: on() });
    if (!shown) return;
    if (on()) follow({ ...shown });
    redraw();
  });
  for (const k of ["a", "b"]) {
    $(`cursor-${k}`).addEventListener("input", (e) => move(k, Number(e.target.value)));
    $(`cursor-${k}-at`).addEventListener("change", (e) => {
      const x = Number(e.target.value.trim().replace(",", ".").replace("−", "-"));
      if (Number.isFinite(x)) move(k, x / shown.per); else fields();
    });
  }
  $("cursors-here").addEventListener("click", () => { gather(); fields(); shown.redraw(); ask(); });
  $("measure").open = Boolean(ui.measuring);
}
