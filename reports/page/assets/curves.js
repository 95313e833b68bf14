"use strict";
/* Training curves: three at a time, the mean over seeds with a band. A data set's file is loaded when it is chosen. */
(function () {
  const { escaped, fill, groups } = window.Report;
  const { CONFIG, layout } = window.Report.axes;
  const FIRST = ["psnr", "primitives", "loss"];
  const loaded = {}; // "section place" -> the curves, once their file is loaded
  const waiting = {};

  window.addCurves = (section, place, curves) => {
    loaded[`${section} ${place}`] = curves;
    (waiting[`${section} ${place}`] || []).forEach((then) => then(curves));
  };

  function load(section, place, file, then) {
    const key = `${section} ${place}`;
    if (loaded[key]) {
      then(loaded[key]);
      return;
    }
    if (!waiting[key]) {
      waiting[key] = [];
      document.head.append(Object.assign(document.createElement("script"), { src: file }));
    }
    waiting[key].push(then);
  }

  function translucent(color) {
    const n = parseInt(color.slice(1), 16);
    return `rgba(${n >> 16},${(n >> 8) & 255},${n & 255},0.16)`;
  }

  function tracesOf(curves, quantity, axis, styles) {
    const traces = [];
    for (const curve of curves.filter((item) => item[quantity])) {
      const band = curve[quantity];
      const style = styles[curve.method];
      const reached = curve[axis].map((value, i) => (value === null || band.low[i] === null ? -1 : i)).filter((i) => i >= 0);
      const xs = reached.map((i) => curve[axis][i]);
      const of = (name) => reached.map((i) => band[name][i]);
      traces.push({ x: xs.concat(xs.slice().reverse()), y: of("high").concat(of("low").reverse()), fill: "toself", fillcolor: translucent(style.color), mode: "lines", line: { width: 0 }, hoverinfo: "skip", showlegend: false });
      traces.push({ name: escaped(curve.method), x: xs, y: of("mean"), mode: "lines+markers", line: { color: style.color, width: 2 }, marker: { symbol: style.symbol, size: 8, maxdisplayed: 7 }, showlegend: true, hovertemplate: `<b>${escaped(curve.method)}</b> %{y:.4g}<extra></extra>` });
    }
    return traces;
  }

  function setUp(group, section, number) {
    const plots = Array.from(group.querySelectorAll(".curves"));
    if (!plots.length) return () => {};
    const dataset = group.querySelector(".curve-dataset");
    const axis = group.querySelector(".curve-x");
    const quantities = Array.from(group.querySelectorAll(".curve-y"));
    fill(dataset, section.curves.map((item, i) => [String(i), item.dataset]));
    quantities.forEach((select, i) => fill(select, Object.entries(window.REPORT.quantities), FIRST[i]));

    function draw() {
      const place = Number(dataset.value);
      load(number, place, section.curves[place].file, (curves) => {
        if (Number(dataset.value) !== place) return; // another was chosen meanwhile
        plots.forEach((plot, i) => {
          const quantity = quantities[i].value;
          const shape = layout(axis.value === "step" ? "step" : "training time, seconds", "", "linear");
          shape.hovermode = "x unified";
          shape.margin = { l: 48, r: 8, t: 8, b: 44 };
          shape.yaxis.rangemode = quantity === "psnr" ? "normal" : "tozero";
          shape.yaxis.type = quantity === "loss" ? "log" : "linear";
          shape.showlegend = i === 0 && curves.length < 9;
          shape.legend = { x: 1, y: 0, xanchor: "right", yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" };
          const traces = tracesOf(curves, quantity, axis.value, section.styles);
          plot.setAttribute("aria-label", `${window.REPORT.quantities[quantity]} of ${traces.length / 2} methods over ${axis.value}`);
          if (!traces.length) shape.annotations = [{ text: "not recorded by these runs", showarrow: false, x: 0.5, y: 0.5, xref: "paper", yref: "paper" }];
          window.Plotly.react(plot, traces, shape, CONFIG);
        });
      });
    }

    [dataset, axis, ...quantities].forEach((control) => control.addEventListener("change", draw));
    draw();
    return draw;
  }

  const redraws = groups.map(([group, section, number]) => setUp(group, section, number));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => redraws.forEach((draw) => draw()));
})();
