// Unpacks plotly, draws the figures whose specifications stand in the page, links the time axes of one record, and fits them to paper.
(function () {
  const unpacked = (id) => {
    const { textContent, dataset } = document.getElementById(id);
    return new TextDecoder().decode(unlzma(bytes(textContent), Number(dataset.length)));
  };
  // base 85 as Python writes it, with a comma in place of "<": five characters are four bytes
  const DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;,=>?@^_`{|}~";
  const bytes = (text) => {
    const value = Object.fromEntries([...DIGITS].map((c, i) => [c, i])), out = new DataView(new ArrayBuffer(4 * Math.ceil(text.length / 5)));
    for (let i = 0, n = 0; i < text.length; n += 4) {
      let word = 0;
      for (let k = 0; k < 5; k++, i++) word = 85 * word + (i < text.length ? value[text[i]] : 84);
      if (!(word < 2 ** 32)) throw new Error("the packed data are damaged");
      out.setUint32(n, word);
    }
    return new Uint8Array(out.buffer, 0, Math.floor((4 * text.length) / 5));
  };
  // numbers are written as their steps, in whole units of their last digit
  const added = (of) => {
    if (!of?.steps) return of;
    let sum = 0;
    return of.steps.map((step) => (step === null ? null : (sum += step) / 10 ** of.digits));
  };
  const PAPER = 690; // px between the margins of an A4 or Letter page, upright
  const LOW = 262; // px: the height of a figure of which three fit on a page; in a lower one the names of two axes would meet
  // these buttons and no others: one of plotly's own would send the data to its maker's server
  const buttons = [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"]];
  const NARROW = 600; // px, below which the buttons would lie on the legend
  const config = { displaylogo: false, responsive: true, modeBarButtons: buttons, ...(innerWidth < NARROW ? { displayModeBar: false } : {}) };
  // a name that is wider than the figure on paper would be cut at its edge
  const LETTER = 6.8, EDGES = 78, SIGN = 46; // px: a letter of a legend, what is beside the axes, the line before a name
  const inLines = (text, most) => text.split(" ").reduce((rows, word) => {
    if (rows.length && `${rows.at(-1)} ${word}`.length <= most) rows.push(`${rows.pop()} ${word}`); else rows.push(word);
    return rows;
  }, []).join("<br>");
  const plots = [];
  try {
    const script = document.createElement("script");
    script.textContent = unpacked("plotly");
    document.head.append(script);
    const places = document.querySelectorAll(".plot"), figures = places.length ? JSON.parse(unpacked("figures")) : {};
    for (const place of places) {
      const figure = figures[place.id];
      const most = Math.floor((Math.min(place.clientWidth, PAPER) - EDGES - SIGN) / LETTER);
      for (const trace of figure.data) {
        for (const axis of ["x", "y"]) if (axis in trace) trace[axis] = added(trace[axis]);
        if (trace.name) trace.name = inLines(trace.name, most);
      }
      Plotly.newPlot(place, figure.data, figure.layout, config);
      plots.push(place);
    }
  } catch (e) {
    document.getElementById("damaged").hidden = false;
    throw e;
  }
  let moving = false;
  for (const one of plots) {
    if (!one.dataset.time) continue;
    one.on("plotly_relayout", (change) => {
      if (moving) return;
      const all = change["xaxis.autorange"];
      const range = change["xaxis.range"] || [change["xaxis.range[0]"], change["xaxis.range[1]"]];
      if (!all && range[0] === undefined) return;
      moving = true;
      const others = plots.filter((p) => p !== one && p.dataset.time === one.dataset.time);
      const to = all ? { "xaxis.autorange": true } : { "xaxis.range": [range[0], range[1]] };
      Promise.all(others.map((p) => Plotly.relayout(p, to))).then(() => { moving = false; });
    });
  }
  const heights = new Map(plots.map((p) => [p, p.layout.height]));
  const fit = (paper) => plots.forEach((p) => {
    const height = paper ? Math.min(heights.get(p), LOW) : heights.get(p);
    p.style.height = `${height}px`;
    Plotly.relayout(p, paper ? { width: PAPER, height } : { width: null, height, autosize: true });
  });
  window.addEventListener("beforeprint", () => fit(true));
  window.addEventListener("afterprint", () => fit(false));
  document.documentElement.dataset.drawn = String(plots.length);
})();
