"use strict";
/* Accuracy against cost: the chart, and beside it the list that does by keyboard all that the chart does by pointer. */
(function () {
  const { element, escaped, fill, groups, mark } = window.Report;
  const { CONFIG, css, frame, layout, namePlaces } = window.Report.axes;

  /* Points that no complete point beats in both, by increasing x. */
  function front(points, xBetter, yBetter) {
    const sx = xBetter === "lower" ? 1 : -1;
    const sy = yBetter === "lower" ? 1 : -1;
    const competing = points.filter((p) => p.complete);
    const beats = (a, b) => sx * a.x <= sx * b.x && sy * a.y <= sy * b.y && (a.x !== b.x || a.y !== b.y);
    return competing.filter((p) => !competing.some((other) => beats(other, p))).sort((a, b) => a.x - b.x);
  }

  /* A value is [mean, lower end, upper end, text]. */
  function pointsOf(subject, x, y) {
    return subject.rows.filter((row) => row.values[x] && row.values[y]).map((row) => ({
      row,
      method: row.method,
      complete: row.complete,
      name: row.complete ? row.method : `${row.method} (${row.done})`,
      x: row.values[x][0],
      y: row.values[y][0],
      vx: row.values[x],
      vy: row.values[y],
    }));
  }

  function whisker(value, shown) {
    const known = shown && value[1] !== null;
    return { type: "data", symmetric: false, array: [known ? value[2] - value[0] : 0], arrayminus: [known ? value[0] - value[1] : 0], thickness: 1.4, width: 0 };
  }

  function facts(point, xColumn, yColumn) {
    return [`${yColumn.title}: ${point.vy[3]}`, `${xColumn.title}: ${point.vx[3]}`, `runs: ${point.row.runs}`, ...point.row.overrides];
  }

  /* From the axis' worse end up to the first point, then step by step, then on to the better end. */
  function staircase(best, points, xColumn, yColumn, logY) {
    const faster = xColumn.better === "lower" ? best : best.slice().reverse();
    const xs = points.map((p) => p.x);
    const far = xColumn.better === "lower" ? Math.max(...xs) * 100 : Math.min(...xs) / 100;
    const beyond = 10 * Math.max(...points.map((p) => Math.abs(p.y)));
    const bottom = yColumn.better === "higher" ? (logY ? 1e-9 : -beyond) : beyond;
    return {
      x: [faster[0].x, ...faster.map((p) => p.x), far],
      y: [bottom, ...faster.map((p) => p.y), faster[faster.length - 1].y],
      mode: "lines",
      hoverinfo: "skip",
      line: { shape: "hv", color: css("--ink"), width: 1.8 },
      opacity: 0.65,
    };
  }

  function sweptLines(sweeps, points) {
    return sweeps.map((sweep) => sweep.map((method) => points.find((p) => p.method === method)).filter(Boolean))
      .filter((line) => line.length > 1)
      .map((line) => ({ x: line.map((p) => p.x), y: line.map((p) => p.y), mode: "lines", hoverinfo: "skip", line: { color: css("--soft"), dash: "dot", width: 1.5 } }));
  }

  function markTrace(section, point, beaten, onFront, place, whiskers, columns) {
    const style = section.styles[point.method];
    const color = beaten ? css("--gray") : style.color;
    const name = escaped(point.name);
    return {
      name: point.method,
      x: [point.x],
      y: [point.y],
      mode: place ? "markers+text" : "markers",
      text: [onFront ? `<b>${name}</b>` : name],
      textposition: place || "top left",
      textfont: { color: beaten ? css("--soft") : css("--ink"), size: 13 },
      cliponaxis: false,
      marker: { size: 14, symbol: style.symbol + (point.complete ? "" : "-open"), color, line: { color: point.complete ? css("--soft") : color, width: point.complete ? 1 : 2.4 } },
      error_x: Object.assign(whisker(point.vx, whiskers), { color }),
      error_y: Object.assign(whisker(point.vy, whiskers), { color }),
      hovertemplate: [`<b>${escaped(point.method)}</b>`, ...facts(point, ...columns).map(escaped)].join("<br>") + "<extra></extra>",
    };
  }

  function setUp(group, section) {
    const plot = group.querySelector(".chart");
    if (!plot) return () => {};
    const pick = (name) => group.querySelector(".chart-" + name);
    const list = group.querySelector(".method-list");
    const about = group.querySelector(".about");
    const hidden = new Set();
    const subject = () => section.subjects[Number(pick("subject").value)];
    const columns = () => [section.columns[pick("x").value], section.columns[pick("y").value]];
    let drawn = [];
    fill(pick("subject"), section.subjects.map((item, i) => [String(i), item.name]), String(section.first));

    function chooseAxes() {
      const there = Object.entries(section.columns).filter(([key]) => subject().rows.some((row) => row.values[key]));
      const keep = (select, role, wanted) => {
        const options = there.filter(([, column]) => column.axis_of === role).map(([key, column]) => [key, column.title]);
        fill(select, options, options.some(([key]) => key === select.value) ? select.value : wanted);
      };
      keep(pick("y"), "accuracy", "psnr");
      keep(pick("x"), "cost", "frame_ms");
    }

    function draw() {
      const [x, y] = columns();
      if (!x || !y) {
        plot.replaceChildren(element("p", { className: "empty", textContent: "Nothing was timed here." }));
        return;
      }
      const all = pointsOf(subject(), pick("x").value, pick("y").value);
      const best = front(all.filter((p) => !hidden.has(p.method)), x.better, y.better);
      const points = all.filter((p) => !hidden.has(p.method) && (p.complete ? pick("dominated").checked || best.includes(p) : pick("failed").checked));
      const log = [pick("log").checked, pick("log-y").checked && points.every((p) => p.y > 0)];
      const ends = (name) => (points.length ? points : all).flatMap((p) => (pick("whiskers").checked ? p[name].slice(0, 3) : [p[name][0]])).filter((value) => value !== null);
      const shape = layout(`${escaped(x.axis)} (${x.better} is better)`, `${escaped(y.axis)} (${y.better} is better)`, "log");
      frame(shape.xaxis, ends("vx"), log[0]);
      frame(shape.yaxis, ends("vy"), log[1]);
      const places = pick("names").checked ? namePlaces(points, best, shape, plot) : [];
      const traces = best.length ? [staircase(best, points, x, y, log[1])] : [];
      traces.push(...sweptLines(section.sweeps, points));
      drawn = points.map((point, i) => ({ point, trace: traces.length + i }));
      traces.push(...points.map((p, i) => markTrace(section, p, p.complete && !best.includes(p), best.includes(p), places[i], pick("whiskers").checked, [x, y])));
      window.Plotly.react(plot, traces, shape, CONFIG);
      plot.dataset.front = best.map((point) => point.method).join("|");
      plot.setAttribute("aria-label", `${y.axis} against ${x.axis} on ${subject().name}: ${points.length} methods; on the front: ${best.map((p) => p.method).join(", ")}`);
      if (group.querySelector(".static-pdf")) ["png", "pdf"].forEach((kind) => { group.querySelector(".static-" + kind).href = `charts/${pick("y").value}-${pick("x").value}.${kind}`; });
      fillList(all, best);
    }

    function fillList(all, best) {
      const focused = list.contains(document.activeElement) ? document.activeElement.dataset.key : null;
      const value = (row, key) => (row.values[key] ? row.values[key][3].split(" ±")[0] : "—");
      list.replaceChildren(...subject().rows.map((row) => {
        const point = all.find((p) => p.method === row.method);
        const box = element("input", { type: "checkbox", checked: !hidden.has(row.method) });
        box.dataset.key = "show " + row.method;
        box.setAttribute("aria-label", "show " + row.method);
        box.addEventListener("change", () => { hidden[box.checked ? "delete" : "add"](row.method); draw(); });
        const numbers = element("span", { className: "numbers", textContent: `${value(row, pick("y").value)} · ${value(row, pick("x").value)}` });
        const name = element("button", { type: "button", className: "pick" }, mark(section.styles[row.method], !row.complete), element("span", { textContent: row.method, className: best.includes(point) ? "on-front" : "" }));
        name.dataset.key = row.method;
        name.title = row.method;
        name.addEventListener("click", () => describe(row));
        const item = element("li", {}, box, name, numbers);
        item.addEventListener("mouseenter", () => highlight(row.method));
        item.addEventListener("mouseleave", () => highlight(null));
        name.addEventListener("focus", () => highlight(row.method));
        name.addEventListener("blur", () => highlight(null));
        return item;
      }));
      const again = Array.from(list.querySelectorAll("[data-key]")).find((node) => node.dataset.key === focused);
      if (again) again.focus();
    }

    /* Fade all marks but one. */
    function highlight(method) {
      if (!drawn.length || (method !== null && !drawn.some((item) => item.point.method === method))) return;
      window.Plotly.restyle(plot, { opacity: drawn.map((item) => (method === null || item.point.method === method ? 1 : 0.18)) }, drawn.map((item) => item.trace));
      plot.dataset.highlight = method || "";
    }

    /* The facts of the hover label as text, with a button to the pictures. */
    function describe(row) {
      const shown = Object.entries(section.columns).filter(([key]) => row.values[key]).map(([key, column]) => element("div", {}, element("dt", { textContent: column.title }), element("dd", { textContent: row.values[key][3] })));
      const overrides = row.overrides.length ? [element("p", { className: "overrides" }, element("code", { textContent: row.overrides.join(" ") }))] : [];
      const pictures = element("button", { type: "button", className: "to-pictures", textContent: "Pictures" });
      pictures.addEventListener("click", () => open(row.method));
      const head = element("p", {}, mark(section.styles[row.method], !row.complete), element("strong", { textContent: row.method }), ` ${row.runs} on ${subject().name} `, ...(section.galleries.length ? [pictures] : []));
      about.replaceChildren(head, element("dl", {}, ...shown), ...overrides);
    }

    function open(method) {
      group.dispatchEvent(new CustomEvent("show-method", { detail: { method, dataset: subject().title } }));
    }

    chooseAxes();
    draw();
    if (plot.on) plot.on("plotly_click", (event) => { if (event.points[0].data.name) open(event.points[0].data.name); });
    pick("subject").addEventListener("change", () => { chooseAxes(); about.replaceChildren(); draw(); });
    ["x", "y", "log", "log-y", "names", "whiskers", "dominated", "failed"].forEach((name) => pick(name).addEventListener("change", draw));
    pick("all").addEventListener("click", () => { hidden.clear(); draw(); });
    pick("none").addEventListener("click", () => { subject().rows.forEach((row) => hidden.add(row.method)); draw(); });
    return draw;
  }

  const redraws = groups.map(([group, section]) => setUp(group, section));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => redraws.forEach((draw) => draw()));
})();
