"use strict";
/* What the charts' axes, ranges and names look like. */
window.Report.axes = (function () {
  const MAX_NAMED = 12; // points, above which a name that covers others is left to the hover and the list
  const FROM_AXIS = 6; // pixels between a name and the axis beside it
  const SIDES = { "top left": [-1, 1], "top right": [1, 1], "bottom right": [1, -1], "bottom left": [-1, -1], "top center": [0, 1], "bottom center": [0, -1], "middle right": [1, 0], "middle left": [-1, 0] };
  const CONFIG = { responsive: true, displaylogo: false, modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]] };

  function css(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  }

  function layout(x, y, xType) {
    const axis = { gridcolor: css("--grid"), zeroline: false, linecolor: css("--line"), tickcolor: css("--line"), automargin: true };
    return {
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: getComputedStyle(document.body).fontFamily, size: 13, color: css("--ink") },
      margin: { l: 60, r: 16, t: 12, b: 52 },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: css("--soft"), activecolor: css("--accent") },
      hoverlabel: { align: "left" },
      hovermode: "closest",
      showlegend: false,
      xaxis: Object.assign({}, axis, { title: { text: x, standoff: 8 }, type: xType }),
      yaxis: Object.assign({}, axis, { title: { text: y, standoff: 8 } }),
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

  /* A range with room for names around the values; its ends in logarithms where the axis is one. */
  function frame(axis, values, log) {
    const scaled = log ? values.filter((value) => value > 0).map(Math.log10) : values;
    const low = Math.min(...scaled);
    const high = Math.max(...scaled);
    const room = Math.max(0.16 * (high - low), log ? 0.04 : 0.005 * Math.abs(high), 1e-9);
    axis.type = log ? "log" : "linear";
    if (!scaled.length) return;
    axis.range = [low - room, high + room];
    if (!log) return;
    axis.tickvals = ticks(10 ** axis.range[0], 10 ** axis.range[1]);
    axis.ticktext = axis.tickvals.map((value) => value.toLocaleString("en", { maximumSignificantDigits: 4 }));
  }

  /* Where each name goes: the place around its mark that covers the least of names and marks; null: nowhere. */
  function namePlaces(points, needed, shape, plot) {
    const width = plot.clientWidth - 100;
    const height = plot.clientHeight - 80;
    const along = (value, axis, size) => (size * ((axis.type === "log" ? Math.log10(value) : value) - axis.range[0])) / (axis.range[1] - axis.range[0]);
    const marks = points.map((p) => [along(p.x, shape.xaxis, width), along(p.y, shape.yaxis, height)]);
    const taken = marks.map(([x, y]) => [x - 8, y - 8, x + 8, y + 8]);
    const pen = document.createElement("canvas").getContext("2d");
    return points.map((point, i) => {
      pen.font = `${needed.includes(point) ? "bold " : ""}13px ${shape.font.family}`;
      const long = pen.measureText(point.name).width;
      const box = ([h, v]) => {
        const left = marks[i][0] + (h === 0 ? -long / 2 : h > 0 ? 9 : -9 - long);
        const bottom = marks[i][1] + (v === 0 ? -8 : v > 0 ? 9 : -25);
        return [left, bottom, left + long, bottom + 16];
      };
      const area = (a, b) => Math.max(0, Math.min(a[2], b[2]) - Math.max(a[0], b[0])) * Math.max(0, Math.min(a[3], b[3]) - Math.max(a[1], b[1]));
      const cost = (b) => taken.reduce((sum, other) => sum + area(b, other), 0) + 30 * Math.max(0, FROM_AXIS - b[0], b[2] - width);
      const best = Object.keys(SIDES).reduce((a, b) => (cost(box(SIDES[b])) < cost(box(SIDES[a])) ? b : a));
      if (points.length > MAX_NAMED && cost(box(SIDES[best])) > 400 && !needed.includes(point)) return null;
      taken.push(box(SIDES[best]));
      return best;
    });
  }

  return { CONFIG, css, frame, layout, namePlaces };
})();
