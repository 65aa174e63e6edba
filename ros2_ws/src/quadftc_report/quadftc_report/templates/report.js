// Draws the figures, those in view first, and keeps the time axes of each scenario's figures the same.
(() => {
  "use strict";
  const TIME_RANGE = /^xaxis\.(range|autorange)/; // a figure has one time axis, whatever the number of its panels
  const PAPER_WIDTH = 680; // px; of a printed page

  const plots = [...document.querySelectorAll(".plot")];
  const drawn = new Set();
  const behind = new Set(); // drawn, but not yet zoomed as the others of their scenario
  const inView = new Set();
  const ranges = new Map(); // scenario -> [start, stop] that the reader chose

  function draw(plot) {
    drawn.add(plot);
    const { data, layout, config } = JSON.parse(document.getElementById(plot.dataset.figure).textContent);
    if (matchMedia("(pointer: coarse)").matches) layout.dragmode = false; // a finger scrolls the page
    Plotly.newPlot(plot, data, layout, config);
    plot.on("plotly_relayout", (change) => zoomed(plot, change));
    if (ranges.has(plot.dataset.scenario)) follow(plot);
  }

  function follow(plot) {
    behind.delete(plot);
    Plotly.relayout(plot, { "xaxis.range": [...ranges.get(plot.dataset.scenario)] });
  }

  function zoomed(plot, change) {
    if (!Object.keys(change).some((key) => TIME_RANGE.test(key))) return;
    const { scenario } = plot.dataset;
    const range = plot.layout.xaxis.range.map(Number);
    if (String(ranges.get(scenario)) === String(range)) return; // it is the one that follows
    ranges.set(scenario, range);
    for (const other of drawn) {
      if (other !== plot && other.dataset.scenario === scenario) behind.add(other);
    }
    work();
  }

  // One figure at a time, those in view first, so that the page answers meanwhile.
  let waiting = false;
  function work() {
    if (waiting) return;
    waiting = true;
    setTimeout(() => {
      waiting = false;
      const open = plots.filter((plot) => !drawn.has(plot) || behind.has(plot));
      const next = open.find((plot) => inView.has(plot)) ?? open[0];
      document.documentElement.dataset.figures = next ? "drawing" : "drawn";
      if (!next) {
        performance.mark("figures-drawn");
        return;
      }
      (drawn.has(next) ? follow : draw)(next);
      work();
    });
  }

  const observer = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) inView[isIntersecting ? "add" : "delete"](target);
  });
  plots.forEach((plot) => observer.observe(plot));

  addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach((part) => part.setAttribute("open", ""));
    for (const plot of plots) {
      if (!drawn.has(plot)) draw(plot);
      Plotly.relayout(plot, { width: PAPER_WIDTH });
    }
  });
  addEventListener("afterprint", () => {
    for (const plot of plots) Plotly.relayout(plot, { width: null, autosize: true });
  });
  work();
})();
