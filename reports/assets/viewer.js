"use strict";
/* The picture viewer: ground truth against any method, with a slider, side by side, or as a difference. */
(function () {
  const TARGET = "target";

  function option(value, text, chosen) {
    return new Option(text, value, false, value === chosen);
  }

  /* Every picture of a view: [key, name, path], by groups for the menus. */
  function sources(shot) {
    const groups = [["", [[TARGET, "ground truth", shot.target]]], ["methods", []]];
    for (const [method, path] of Object.entries(shot.renders)) groups[1][1].push([method, method, path]);
    for (const [method, layers] of Object.entries(shot.layers)) {
      groups.push([method + ", layers", Object.entries(layers).map(([layer, path]) => [method + "\u0000" + layer, `${method}: ${layer === "beta" ? "β" : layer}`, path])]);
    }
    return groups;
  }

  function fillSources(select, groups, chosen) {
    select.replaceChildren();
    for (const [label, items] of groups) {
      const parent = label ? document.createElement("optgroup") : select;
      if (label) parent.label = label;
      items.forEach(([key, name]) => parent.append(option(key, name, chosen)));
      if (label && items.length) select.append(parent);
    }
  }

  function setUp(group, section) {
    const root = group.querySelector(".viewer");
    if (!root) return;
    const pick = (name) => root.querySelector(".viewer-" + name);
    const stage = root.querySelector(".stage");
    const split = root.querySelector(".split");
    const strip = root.querySelector(".strip");
    const state = { zoom: 1, x: 0, y: 0 };
    const gallery = () => section.galleries.find((item) => item.dataset === pick("dataset").value);
    const shot = () => gallery().shots[Number(pick("view").value)];

    pick("dataset").replaceChildren(...section.galleries.map((item) => option(item.dataset, item.dataset)));

    function fillViews() {
      pick("view").replaceChildren(...gallery().shots.map((item, i) => option(String(i), item.title)));
      fillPictures();
    }

    function fillPictures() {
      const groups = sources(shot());
      const keys = groups.flatMap(([, items]) => items.map(([key]) => key));
      const best = Object.entries(shot().psnr).sort((a, b) => b[1] - a[1]).map(([method]) => method)[0];
      const keep = (select, wanted) => (keys.includes(select.value) ? select.value : wanted);
      fillSources(pick("a"), groups, keep(pick("a"), TARGET));
      fillSources(pick("b"), groups, keep(pick("b"), best || keys[1]));
      fillStrip();
      show();
    }

    function fillStrip() {
      strip.replaceChildren(...sources(shot()).slice(0, 2).flatMap(([, items]) => items).map(([key, name, path]) => {
        const item = document.createElement("li");
        const button = document.createElement("button");
        const picture = document.createElement("img");
        const title = document.createElement("b");
        const score = document.createElement("span");
        button.type = "button";
        button.dataset.key = key;
        picture.loading = "lazy";
        picture.src = path;
        picture.alt = "";
        title.textContent = name;
        score.textContent = shot().psnr[key] === undefined ? "" : ` ${shot().psnr[key].toFixed(2)} dB`;
        button.append(picture, title, score);
        button.addEventListener("click", () => { pick("b").value = key; show(); });
        item.append(button);
        return item;
      }));
    }

    function place(side) {
      const [, name, path] = sources(shot()).flatMap(([, items]) => items).find(([key]) => key === pick(side).value);
      const image = root.querySelector(".img-" + side);
      if (image.getAttribute("src") !== path) image.src = path;
      image.alt = `${name}, ${shot().title} of ${gallery().dataset}`;
      root.querySelector(".tag-" + side).textContent = name;
    }

    function show() {
      place("a");
      place("b");
      strip.querySelectorAll("button").forEach((button) => button.setAttribute("aria-pressed", String(button.dataset.key === pick("b").value)));
      stage.dataset.mode = pick("mode").value;
      split.disabled = pick("mode").value !== "slider";
      move();
    }

    function move() {
      const limit = 50 - 50 / state.zoom;
      state.x = Math.max(-limit, Math.min(limit, state.x));
      state.y = Math.max(-limit, Math.min(limit, state.y));
      stage.style.setProperty("--zoom", state.zoom);
      stage.style.setProperty("--pan-x", state.x + "%");
      stage.style.setProperty("--pan-y", state.y + "%");
      stage.style.setProperty("--split", split.value + "%");
      pick("zoom").value = String(state.zoom);
    }

    /* Small renders are shown by their pixels: smoothing would invent what no method drew. */
    function fit(event) {
      const image = event.target;
      root.style.setProperty("--ratio", String(image.naturalWidth / image.naturalHeight || 1.333));
      image.classList.toggle("pixels", image.clientWidth * state.zoom > image.naturalWidth);
    }

    function zoomTo(zoom, event) {
      if (event && zoom > 1) {
        const box = stage.getBoundingClientRect();
        state.x = 50 - (100 * (event.clientX - box.left)) / box.width;
        state.y = 50 - (100 * (event.clientY - box.top)) / box.height;
      }
      state.zoom = zoom;
      move();
      root.querySelectorAll(".window img").forEach((image) => fit({ target: image }));
    }

    let held = null;
    stage.addEventListener("pointerdown", (event) => {
      held = { x: event.clientX, y: event.clientY, panX: state.x, panY: state.y };
      stage.setPointerCapture(event.pointerId);
      if (pick("mode").value === "slider" && state.zoom === 1) slide(event);
    });
    stage.addEventListener("pointermove", (event) => {
      if (!held) return;
      const box = stage.getBoundingClientRect();
      if (state.zoom === 1) {
        if (pick("mode").value === "slider") slide(event);
        return;
      }
      state.x = held.panX + (100 * (event.clientX - held.x)) / box.width / state.zoom;
      state.y = held.panY + (100 * (event.clientY - held.y)) / box.height / state.zoom;
      move();
    });
    ["pointerup", "pointercancel"].forEach((name) => stage.addEventListener(name, () => { held = null; }));
    stage.addEventListener("dblclick", (event) => zoomTo(state.zoom > 1 ? 1 : 4, event));

    function slide(event) {
      const box = stage.getBoundingClientRect();
      split.value = String((100 * (event.clientX - box.left)) / box.width);
      move();
    }

    root.querySelectorAll(".window img").forEach((image) => image.addEventListener("load", fit));
    split.addEventListener("input", move);
    pick("dataset").addEventListener("change", fillViews);
    pick("view").addEventListener("change", fillPictures);
    pick("zoom").addEventListener("change", () => zoomTo(Number(pick("zoom").value)));
    ["a", "b", "mode"].forEach((name) => pick(name).addEventListener("change", show));
    group.addEventListener("show-method", (event) => {
      const { method, dataset } = event.detail;
      if (section.galleries.some((item) => item.dataset === dataset) && pick("dataset").value !== dataset) {
        pick("dataset").value = dataset;
        fillViews();
      }
      if (method in shot().renders) {
        pick("b").value = method;
        show();
        root.scrollIntoView();
      }
    });
    fillViews();
  }

  document.querySelectorAll("[data-section]").forEach((group) => {
    setUp(group, window.REPORT.sections[Number(group.dataset.section)]);
  });
})();
