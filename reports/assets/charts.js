"use strict";
/* The interactive charts: accuracy against speed, and training curves. Data: window.REPORT (data.js). */
(function () {
  const UNBEATEN_LINE = 2;

  function css(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  }

  function layout(x, y, xType) {
    const axis = { gridcolor: css("--grid"), zeroline: false, linecolor: css("--line"), tickcolor: css("--line"), automargin: true };
    return {
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: getComputedStyle(document.body).fontFamily, size: 13, color: css("--ink") },
      margin: { l: 60, r: 20, t: 12, b: 52 },
      hoverlabel: { align: "left" },
      hovermode: "closest",
      showlegend: false,
      xaxis: Object.assign({}, axis, { title: { text: x }, type: xType }, xType === "log" ? { dtick: "D2" } : {}),
      yaxis: Object.assign({}, axis, { title: { text: y } }),
    };
  }

  const CONFIG = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };

  function escaped(text) {
    return String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  }

  function fill(select, options, chosen) {
    select.replaceChildren(...options.map(([value, text]) => new Option(text, value, false, value === chosen)));
  }

  /* Points that no complete point beats in both, by increasing x. */
  function front(points, xBetter, yBetter) {
    const sx = xBetter === "lower" ? 1 : -1;
    const sy = yBetter === "lower" ? 1 : -1;
    const competing = points.filter((p) => p.complete);
    const beats = (a, b) => sx * a.x <= sx * b.x && sy * a.y <= sy * b.y && (a.x !== b.x || a.y !== b.y);
    return competing.filter((p) => !competing.some((other) => beats(other, p))).sort((a, b) => a.x - b.x);
  }

  function pointsOf(table, x, y) {
    const points = [];
    for (const row of table.rows) {
      const cx = row.cells[x];
      const cy = row.cells[y];
      if (!cx || !cy || cx.mean === null || cy.mean === null) continue;
      if (cx.partial_average || cy.partial_average) continue;
      points.push({ row, x: cx.mean, y: cy.mean, cx, cy, complete: row.done === row.attempts });
    }
    return points;
  }

  function whisker(cells, values) {
    const plus = cells.map((cell, i) => (cell.interval ? cell.interval[1] - values[i] : 0));
    const minus = cells.map((cell, i) => (cell.interval ? values[i] - cell.interval[0] : 0));
    return { type: "data", symmetric: false, array: plus, arrayminus: minus, thickness: 1.4, width: 0 };
  }

  function hover(point, xColumn, yColumn) {
    const row = point.row;
    const lines = [`<b>${escaped(row.method)}</b>  (${escaped(row.runs)} runs)`];
    lines.push(`${escaped(yColumn.title)}: ${escaped(point.cy.text)}`, `${escaped(xColumn.title)}: ${escaped(point.cx.text)}`);
    if (row.overrides.length) lines.push("", ...row.overrides.map(escaped));
    return lines.join("<br>");
  }

  function paretoTraces(section, table, x, y, options) {
    const columns = Object.fromEntries(table.columns.map((column) => [column.key, column]));
    const points = pointsOf(table, x, y);
    const best = front(points, columns[x].better, columns[y].better);
    const traces = [];
    if (best.length) traces.push(staircase(best, points, columns[x], columns[y]));
    for (const knob of section.knobs) {
      const line = knob.map((method) => points.find((p) => p.row.method === method)).filter(Boolean);
      if (line.length > 1) {
        traces.push({ x: line.map((p) => p.x), y: line.map((p) => p.y), mode: "lines", hoverinfo: "skip", line: { color: css("--soft"), dash: "dot", width: 1.2 } });
      }
    }
    for (const point of points) {
      const style = section.styles[point.row.method];
      const beaten = point.complete && !best.includes(point);
      if (beaten && !options.dominated) continue;
      const color = beaten ? css("--soft") : style.color;
      const name = point.complete ? point.row.method : `${point.row.method} (${point.row.done}/${point.row.attempts})`;
      traces.push({
        name: point.row.method,
        x: [point.x],
        y: [point.y],
        mode: options.names ? "markers+text" : "markers",
        text: [`${best.includes(point) ? "<b>" + escaped(name) + "</b>" : escaped(name)}`],
        textposition: "top left",
        textfont: { color: beaten ? css("--soft") : css("--ink") },
        cliponaxis: false,
        opacity: beaten ? 0.75 : 1,
        marker: { size: 14, symbol: style.symbol + (point.complete ? "" : "-open"), color, line: { color: point.complete ? css("--paper") : color, width: 2 } },
        error_x: Object.assign(whisker([point.cx], [point.x]), { color }),
        error_y: Object.assign(whisker([point.cy], [point.y]), { color }),
        hovertemplate: hover(point, columns[x], columns[y]) + "<extra></extra>",
      });
    }
    return { traces, best, points };
  }

  /* From the axis' worse end up to the first point, then step by step, then on to the better end. */
  function staircase(best, points, xColumn, yColumn) {
    const faster = xColumn.better === "lower" ? best : best.slice().reverse();
    const xs = points.map((p) => p.x);
    const ys = points.map((p) => p.y);
    const far = xColumn.better === "lower" ? Math.max(...xs) * 1.6 : Math.min(...xs) / 1.6;
    const span = Math.max(...ys) - Math.min(...ys) || 1;
    const bottom = yColumn.better === "higher" ? Math.min(...ys) - 0.12 * span : Math.max(...ys) + 0.12 * span;
    return {
      x: [faster[0].x, ...faster.map((p) => p.x), far],
      y: [bottom, ...faster.map((p) => p.y), faster[faster.length - 1].y],
      mode: "lines",
      hoverinfo: "skip",
      line: { shape: "hv", color: css("--ink"), width: UNBEATEN_LINE },
      opacity: 0.7,
    };
  }

  function axisName(column) {
    return `${column.explanation || column.title} (${column.better === "higher" ? "higher" : "lower"} is better)`;
  }

  function setUpPareto(group, section) {
    const plot = group.querySelector(".chart");
    if (!plot) return () => {};
    const pick = (name) => group.querySelector(".chart-" + name);
    fill(pick("table"), section.tables.map((table, i) => [String(i), table.name]), String(section.first_table));
    const current = () => section.tables[Number(pick("table").value)];

    function axes() {
      const has = (c) => pointsOf(current(), c.key, c.key).length > 0;
      const columns = current().columns.filter(has);
      const costs = columns.filter((c) => c.cost);
      const scores = columns.filter((c) => !c.cost);
      const keep = (select, list, wanted) => {
        const chosen = list.some((c) => c.key === select.value) ? select.value : wanted;
        fill(select, list.map((c) => [c.key, c.title]), chosen);
      };
      keep(pick("y"), scores, "psnr");
      keep(pick("x"), costs, "frame_ms");
    }

    function draw() {
      const table = current();
      const x = pick("x").value;
      const y = pick("y").value;
      if (!x || !y) return;
      const columns = Object.fromEntries(table.columns.map((column) => [column.key, column]));
      const options = { names: pick("names").checked, dominated: pick("dominated").checked };
      const { traces, best } = paretoTraces(section, table, x, y, options);
      window.Plotly.react(plot, traces, layout(axisName(columns[x]), axisName(columns[y]), pick("log").checked ? "log" : "linear"), CONFIG);
      plot.dataset.front = best.map((point) => point.row.method).join("|");
    }

    axes();
    draw();
    plot.on("plotly_click", (event) => {
      const method = event.points[0].data.name;
      group.dispatchEvent(new CustomEvent("show-method", { detail: { method, dataset: current().title } }));
    });
    pick("table").addEventListener("change", () => { axes(); draw(); });
    ["x", "y", "log", "names", "dominated"].forEach((name) => pick(name).addEventListener("change", draw));
    return draw;
  }

  function translucent(color) {
    const n = parseInt(color.slice(1), 16);
    return `rgba(${n >> 16},${(n >> 8) & 255},${n & 255},0.18)`;
  }

  function setUpCurves(group, section) {
    const plot = group.querySelector(".curves");
    if (!plot) return () => {};
    const pick = (name) => group.querySelector(".curve-" + name);
    fill(pick("dataset"), section.curves.map((item) => [item.dataset, item.dataset]));
    fill(pick("y"), Object.entries(section.quantities), "psnr");

    function draw() {
      const quantity = pick("y").value;
      const axis = pick("x").value;
      const item = section.curves.find((other) => other.dataset === pick("dataset").value);
      const traces = [];
      for (const curve of item.curves) {
        const band = curve[quantity];
        if (!band) continue;
        const color = section.styles[curve.method].color;
        const reached = curve[axis].map((value, i) => (value === null || band.low[i] === null ? -1 : i)).filter((i) => i >= 0);
        const xs = reached.map((i) => curve[axis][i]);
        const of = (name) => reached.map((i) => band[name][i]);
        traces.push({ x: xs.concat(xs.slice().reverse()), y: of("high").concat(of("low").reverse()), fill: "toself", fillcolor: translucent(color), mode: "lines", line: { width: 0 }, hoverinfo: "skip" });
        traces.push({ name: curve.method, x: xs, y: of("mean"), mode: "lines", line: { color, width: 2 }, showlegend: true, hovertemplate: `<b>${escaped(curve.method)}</b> %{y:.4g}<extra></extra>` });
      }
      const shape = layout(axis === "step" ? "step" : "training time, seconds", section.quantities[quantity], "linear");
      shape.hovermode = "x unified";
      shape.showlegend = true;
      shape.legend = { orientation: "h", y: 1.12, x: 0 };
      if (quantity === "loss") shape.yaxis.type = "log";
      window.Plotly.react(plot, traces, shape, CONFIG);
    }

    ["dataset", "x", "y"].forEach((name) => pick(name).addEventListener("change", draw));
    draw();
    return draw;
  }

  /* One data set at a time: a choice in one place is taken over wherever the same data set exists. */
  function synchronize(group) {
    const selects = Array.from(group.querySelectorAll(".dataset-select"));
    selects.forEach((select) => select.addEventListener("change", (event) => {
      if (!event.isTrusted && event.detail === "echo") return;
      const name = select.selectedOptions[0] ? select.selectedOptions[0].text : "";
      selects.filter((other) => other !== select).forEach((other) => {
        const option = Array.from(other.options).find((candidate) => candidate.text === name);
        if (option && !option.selected) {
          option.selected = true;
          other.dispatchEvent(new CustomEvent("change", { detail: "echo" }));
        }
      });
    }));
  }

  const redraws = [];
  document.querySelectorAll("[data-section]").forEach((group) => {
    const section = window.REPORT.sections[Number(group.dataset.section)];
    redraws.push(setUpPareto(group, section), setUpCurves(group, section));
    synchronize(group);
  });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => redraws.forEach((draw) => draw()));
})();
