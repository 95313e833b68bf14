"use strict";
/* The interactive charts: accuracy against speed, and training curves. Data: window.REPORT (data.js). */
(function () {
  const CROWD = 12; // points, above which a beaten one's name that covers others is left to the hover

  function css(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  }

  function layout(x, y, xType) {
    const axis = { gridcolor: css("--grid"), zeroline: false, linecolor: css("--line"), tickcolor: css("--line"), automargin: true };
    return {
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: getComputedStyle(document.body).fontFamily, size: 13, color: css("--ink") },
      margin: { l: 60, r: 24, t: 12, b: 52 },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: css("--soft"), activecolor: css("--accent") },
      hoverlabel: { align: "left" },
      hovermode: "closest",
      showlegend: false,
      xaxis: Object.assign({}, axis, { title: { text: x }, type: xType }),
      yaxis: Object.assign({}, axis, { title: { text: y } }),
    };
  }

  const CONFIG = { responsive: true, displaylogo: false, modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]] };

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
      const complete = row.done === row.attempts;
      const name = complete ? row.method : `${row.method} (${row.done}/${row.attempts})`;
      points.push({ row, name, complete, x: cx.mean, y: cy.mean, cx, cy });
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

  function paretoTraces(section, points, best, x, y, options) {
    const traces = best.length ? [staircase(best, points, x, y)] : [];
    for (const knob of section.knobs) {
      const line = knob.map((method) => points.find((p) => p.row.method === method)).filter(Boolean);
      if (line.length > 1) {
        traces.push({ x: line.map((p) => p.x), y: line.map((p) => p.y), mode: "lines", hoverinfo: "skip", line: { color: css("--soft"), dash: "dot", width: 1.2 } });
      }
    }
    points.forEach((point, i) => {
      const style = section.styles[point.row.method];
      const beaten = point.complete && !best.includes(point);
      if (beaten && !options.dominated) return;
      const color = beaten ? css("--soft") : style.color;
      const name = escaped(point.name);
      traces.push({
        name: point.row.method,
        x: [point.x],
        y: [point.y],
        mode: options.names && options.places[i] ? "markers+text" : "markers",
        text: [best.includes(point) ? `<b>${name}</b>` : name],
        textposition: options.places[i] || "top left",
        textfont: { color: beaten ? css("--soft") : css("--ink") },
        cliponaxis: false,
        opacity: beaten ? 0.75 : 1,
        marker: { size: 14, symbol: style.symbol + (point.complete ? "" : "-open"), color, line: { color: point.complete ? css("--paper") : color, width: 2 } },
        error_x: Object.assign(whisker([point.cx], [point.x]), { color }),
        error_y: Object.assign(whisker([point.cy], [point.y]), { color }),
        hovertemplate: hover(point, x, y) + "<extra></extra>",
      });
    });
    return traces;
  }

  /* From the axis' worse end up to the first point, then step by step, then on to the better end. */
  function staircase(best, points, xColumn, yColumn) {
    const faster = xColumn.better === "lower" ? best : best.slice().reverse();
    const xs = points.map((p) => p.x);
    const ys = points.map((p) => p.y);
    const far = xColumn.better === "lower" ? Math.max(...xs) * 100 : Math.min(...xs) / 100;
    const beyond = 10 * Math.max(...ys.map(Math.abs));
    const bottom = yColumn.better === "higher" ? -beyond : beyond;
    return {
      x: [faster[0].x, ...faster.map((p) => p.x), far],
      y: [bottom, ...faster.map((p) => p.y), faster[faster.length - 1].y],
      mode: "lines",
      hoverinfo: "skip",
      line: { shape: "hv", color: css("--ink"), width: 2 },
      opacity: 0.7,
    };
  }

  /* 1, 2 and 5 times powers of ten; on an axis too short for three of them, even steps. */
  function ticks(low, high) {
    const found = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power += 1) {
      [1, 2, 5].forEach((digit) => found.push(Number((digit * 10 ** power).toPrecision(1))));
    }
    if (found.filter((value) => value >= low && value <= high).length > 2) return found;
    const unit = 10 ** Math.floor(Math.log10((high - low) / 4));
    const step = [1, 2, 5, 10].map((digit) => digit * unit).find((size) => (high - low) / size <= 6);
    const count = Math.floor(high / step) - Math.ceil(low / step) + 1;
    return Array.from({ length: count }, (_, i) => Number(((Math.ceil(low / step) + i) * step).toPrecision(6)));
  }

  /* Ranges with room for names, and ticks at 1, 2 and 5 on a logarithmic axis. */
  function frame(shape, points, log) {
    const ends = (cell, value) => [value, ...(cell.interval || [])];
    const xs = points.flatMap((p) => ends(p.cx, p.x));
    const ys = points.flatMap((p) => ends(p.cy, p.y));
    const pad = Math.max(0.16 * (Math.max(...ys) - Math.min(...ys)), 0.01 * Math.abs(Math.max(...ys)), 1e-9);
    shape.yaxis.range = [Math.min(...ys) - pad, Math.max(...ys) + pad];
    if (!log) {
      const room = Math.max(0.16 * (Math.max(...xs) - Math.min(...xs)), 1e-9);
      shape.xaxis.range = [Math.min(...xs) - room, Math.max(...xs) + room];
      return;
    }
    const low = Math.log10(Math.min(...xs));
    const high = Math.log10(Math.max(...xs));
    const room = Math.max(0.16 * (high - low), 0.1);
    shape.xaxis.range = [low - room, high + room];
    shape.xaxis.tickvals = ticks(10 ** (low - room), 10 ** (high + room));
    shape.xaxis.ticktext = shape.xaxis.tickvals.map((value) => value.toLocaleString("en", { maximumSignificantDigits: 3 }));
  }

  /* Where each name goes: the first place around its mark that covers no other name and no other mark; null: nowhere. */
  function namePlaces(points, front, shape, plot, log) {
    const width = plot.clientWidth - 100;
    const height = plot.clientHeight - 80;
    const along = (value, range, size) => (size * (value - range[0])) / (range[1] - range[0]);
    const marks = points.map((p) => [along(log ? Math.log10(p.x) : p.x, shape.xaxis.range, width), along(p.y, shape.yaxis.range, height)]);
    const taken = marks.map(([x, y]) => [x - 8, y - 8, x + 8, y + 8]);
    const sides = { "top left": [-1, 1], "top right": [1, 1], "bottom right": [1, -1], "bottom left": [-1, -1], "top center": [0, 1], "bottom center": [0, -1] };
    return points.map((point, i) => {
      const long = 7.6 * point.name.length;
      const box = ([h, v]) => {
        const left = marks[i][0] + (h === 0 ? -long / 2 : h > 0 ? 9 : -9 - long);
        const bottom = marks[i][1] + (v > 0 ? 9 : -25);
        return [left, bottom, left + long, bottom + 16];
      };
      const area = (a, b) => Math.max(0, Math.min(a[2], b[2]) - Math.max(a[0], b[0])) * Math.max(0, Math.min(a[3], b[3]) - Math.max(a[1], b[1]));
      const cost = (b) => taken.reduce((sum, other) => sum + area(b, other), 0) + 10 * Math.max(0, -b[0], b[2] - width);
      const names = Object.keys(sides);
      const best = names.reduce((a, b) => (cost(box(sides[b])) < cost(box(sides[a])) ? b : a));
      const crowded = points.length > CROWD && cost(box(sides[best])) > 400;
      if (crowded && !front.includes(point)) return null;
      taken.push(box(sides[best]));
      return best;
    });
  }

  function axisName(column) {
    return `${column.axis} (${column.better} is better)`;
  }

  function setUpPareto(group, section) {
    const plot = group.querySelector(".chart");
    if (!plot) return () => {};
    const pick = (name) => group.querySelector(".chart-" + name);
    fill(pick("table"), section.charted.map((i) => [String(i), section.tables[i].name]), String(section.first_charted));
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
      const columns = Object.fromEntries(current().columns.map((column) => [column.key, column]));
      const x = columns[pick("x").value];
      const y = columns[pick("y").value];
      if (!x || !y) return;
      const log = pick("log").checked;
      const points = pointsOf(current(), x.key, y.key);
      const best = front(points, x.better, y.better);
      const shape = layout(axisName(x), axisName(y), log ? "log" : "linear");
      frame(shape, points, log);
      const places = namePlaces(points, best, shape, plot, log);
      const options = { names: pick("names").checked, dominated: pick("dominated").checked, places };
      window.Plotly.react(plot, paretoTraces(section, points, best, x, y, options), shape, CONFIG);
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
        traces.push({ x: xs.concat(xs.slice().reverse()), y: of("high").concat(of("low").reverse()), fill: "toself", fillcolor: translucent(color), mode: "lines", line: { width: 0 }, hoverinfo: "skip", showlegend: false });
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
