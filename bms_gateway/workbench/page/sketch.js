// A first picture while the plots' script is still being loaded: the readings as one line, with the ends of its axes.
const SVG = "http://www.w3.org/2000/svg";
const W = 800, H = 380, LEFT = 64, RIGHT = 786, TOP = 34, BOTTOM = 338;

function node(tag, attributes, text = "") {
  const n = document.createElementNS(SVG, tag);
  for (const [k, v] of Object.entries(attributes)) n.setAttribute(k, v);
  n.textContent = text;
  return n;
}

export function sketch(place, figure) {
  const { x, y } = figure.data.find((d) => d.name === "measured") ?? { x: [], y: [] };
  const there = y.map((v, i) => [x[i], v]).filter(([, v]) => v !== null);
  if (there.length < 2) return false;
  const values = there.map(([, v]) => v);
  const low = Math.min(...values), high = Math.max(...values), first = there[0][0], last = there.at(-1)[0];
  const at = ([t, v]) => `${(LEFT + ((RIGHT - LEFT) * (t - first)) / (last - first || 1)).toFixed(1)},${(BOTTOM - ((BOTTOM - TOP) * (v - low)) / (high - low || 1)).toFixed(1)}`;
  const svg = node("svg", { viewBox: `0 0 ${W} ${H}`, width: "100%", height: H, preserveAspectRatio: "none", "font-size": 12, fill: "currentColor" });
  svg.append(node("polyline", { points: there.map(at).join(" "), fill: "none", stroke: "currentColor", "vector-effect": "non-scaling-stroke" }),
    node("text", { x: LEFT - 6, y: TOP + 4, "text-anchor": "end" }, high.toFixed(1)), node("text", { x: LEFT - 6, y: BOTTOM, "text-anchor": "end" }, low.toFixed(1)),
    node("text", { x: LEFT, y: BOTTOM + 18 }, first.toFixed(0)), node("text", { x: RIGHT, y: BOTTOM + 18, "text-anchor": "end" }, last.toFixed(0)),
    node("text", { x: LEFT, y: TOP - 14 }, `${figure.layout.yaxis.title.text}; measured`), node("text", { x: W / 2, y: BOTTOM + 34, "text-anchor": "middle" }, figure.layout.xaxis.title.text));
  place.replaceChildren(svg);
  return true;
}
