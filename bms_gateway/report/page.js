// Unpacks plotly, draws the figures whose specifications stand in the page, links the time axes of one record, and fits them to paper.
(function () {
  const unpacked = (id) => {
    const { textContent, dataset } = document.getElementById(id);
    return new TextDecoder().decode(unlzma(Uint8Array.from(atob(textContent), (c) => c.charCodeAt(0)), Number(dataset.length)));
  };
  const PAPER = 690; // px between the margins of an A4 or Letter page, upright
  // these buttons and no others: one of plotly's own would send the data to its maker's server
  const buttons = [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"]];
  const config = { displaylogo: false, responsive: true, modeBarButtons: buttons };
  const plots = [];
  try {
    const script = document.createElement("script");
    script.textContent = unpacked("plotly");
    document.head.append(script);
    const places = document.querySelectorAll(".plot"), figures = places.length ? JSON.parse(unpacked("figures")) : {};
    for (const place of places) {
      const figure = figures[place.id];
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
  const fit = (width) => plots.forEach((p) => Plotly.relayout(p, width ? { width: width } : { width: null, autosize: true }));
  window.addEventListener("beforeprint", () => fit(PAPER));
  window.addEventListener("afterprint", () => fit(0));
  document.documentElement.dataset.drawn = String(plots.length);
})();
