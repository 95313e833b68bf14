"use strict";
/* The picture viewer: any two of ground truth and methods, in any of their layers, with a slider, side by side, or as
   their difference. */
(function () {
  const { element, fill, groups } = window.Report;
  const TARGET = "ground truth";
  const NAMES = { image: "image", beta: "β", flip: "FLIP map", error: "error map" };
  const OF_PICTURES = ["image", "error", "flip"]; // what is compared with the photograph
  const MAX_ENLARGEMENT = 8; // screen pixels a pixel of the picture, unzoomed
  const PAN = 4; // per cent of the picture, a key press

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
    const layer = () => pick("layer").value || "image";

    fill(pick("dataset"), section.galleries.map((item) => [item.dataset, item.dataset]));

    function fillViews() {
      fill(pick("view"), gallery().shots.map((item, i) => [String(i), item.title]));
      fillChoices();
    }

    function fillChoices() {
      const methods = Object.keys(shot().pictures);
      const layers = [...new Set(methods.flatMap((method) => Object.keys(shot().pictures[method])))];
      const best = Object.entries(shot().psnr).sort((a, b) => b[1] - a[1]).map(([method]) => method)[0];
      const keep = (select, values, wanted) => (values.includes(select.value) ? select.value : wanted);
      const sources = [TARGET, ...methods];
      const options = sources.map((name) => [name, name]);
      fill(pick("a"), options, keep(pick("a"), sources, TARGET));
      fill(pick("b"), options, keep(pick("b"), sources, best || methods[0]));
      fill(pick("layer"), layers.map((name) => [name, NAMES[name] || name]), keep(pick("layer"), layers, "image"));
      show();
    }

    /* Like with like: beside a normal the exact one, beside a picture or its errors the photograph, beside another layer
       nothing of the ground truth's. null: there is no such layer. */
    function path(source) {
      if (source !== TARGET) return shot().pictures[source][layer()] || null;
      return shot().target[OF_PICTURES.includes(layer()) ? "image" : layer()] || null;
    }

    /* What the layer shown is scored by, of a method. */
    function score(source) {
      if (layer() === "normal") return source in shot().degrees ? `${shot().degrees[source].toFixed(1)}°` : "";
      return OF_PICTURES.includes(layer()) && source in shot().psnr ? `${shot().psnr[source].toFixed(2)} dB` : "";
    }

    /* Where the ground truth has no such layer, another method's stands on the left. */
    function compareLayers() {
      const others = Object.keys(shot().pictures).filter((name) => name !== pick("b").value && path(name) !== null);
      if (pick("a").value === TARGET && path(TARGET) === null && others.length) pick("a").value = others[others.length - 1];
      show();
    }

    function caption(source) {
      const photograph = source === TARGET && OF_PICTURES.includes(layer());
      return photograph || layer() === "image" ? source : `${source}: ${NAMES[layer()] || layer()}`;
    }

    function fillStrip() {
      strip.replaceChildren(...Array.from(pick("b").options).map((option) => {
        const name = option.value;
        const file = path(name);
        const button = element("button", { type: "button" },
          file ? element("img", { loading: "lazy", src: file, alt: "", width: shot().size[0], height: shot().size[1] }) : element("span", { className: "absent", textContent: "none" }),
          element("b", { textContent: name }),
          element("span", { textContent: ` ${score(name)}` }));
        button.dataset.key = name;
        button.addEventListener("click", () => { pick("b").value = name; show(); });
        return element("li", {}, button);
      }));
    }

    function place(side) {
      const source = pick(side).value;
      const file = path(source);
      const image = root.querySelector(".img-" + side);
      image.hidden = file === null;
      [image.width, image.height] = shot().size;
      if (file !== null && image.getAttribute("src") !== file) image.src = file;
      image.alt = `${caption(source)}, ${shot().title} of ${gallery().dataset}`;
      root.querySelector(".tag-" + side).textContent = caption(source) + (file === null ? ": none" : "");
    }

    function show() {
      place("a");
      place("b");
      const focused = strip.contains(document.activeElement) ? document.activeElement.dataset.key : null;
      fillStrip();
      strip.querySelectorAll("button").forEach((button) => {
        button.setAttribute("aria-pressed", String(button.dataset.key === pick("b").value));
        if (button.dataset.key === focused) button.focus();
      });
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
      root.style.setProperty("--largest", `${MAX_ENLARGEMENT * image.naturalWidth || 1000}px`);
      image.classList.toggle("pixels", image.clientWidth * state.zoom > image.naturalWidth);
    }

    function zoomTo(zoom, event) {
      if (event && zoom > 1) {
        const box = stage.getBoundingClientRect();
        state.x = 50 - (100 * (event.clientX - box.left)) / box.width;
        state.y = 50 - (100 * (event.clientY - box.top)) / box.height;
      }
      state.zoom = Math.max(1, Math.min(8, zoom));
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

    function otherView(step) {
      const count = gallery().shots.length;
      pick("view").value = String((Number(pick("view").value) + step + count) % count);
      fillChoices();
    }

    stage.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      const others = { "+": () => zoomTo(state.zoom * 2), "=": () => zoomTo(state.zoom * 2), "-": () => zoomTo(state.zoom / 2), "[": () => otherView(-1), "]": () => otherView(1) };
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (others[event.key]) others[event.key]();
      else if (steps[event.key] && state.zoom > 1) {
        state.x += (PAN * steps[event.key][0]) / state.zoom;
        state.y += (PAN * steps[event.key][1]) / state.zoom;
        move();
      } else if (steps[event.key] && steps[event.key][0] && pick("mode").value === "slider") {
        split.value = String(Number(split.value) - 2 * steps[event.key][0]);
        move();
      } else return;
      event.preventDefault();
    });

    root.querySelectorAll(".window img").forEach((image) => image.addEventListener("load", fit));
    split.addEventListener("input", move);
    pick("dataset").addEventListener("change", fillViews);
    pick("view").addEventListener("change", fillChoices);
    pick("zoom").addEventListener("change", () => zoomTo(Number(pick("zoom").value)));
    ["a", "b", "mode"].forEach((name) => pick(name).addEventListener("change", show));
    pick("layer").addEventListener("change", compareLayers);
    group.addEventListener("show-method", (event) => {
      const { method, dataset } = event.detail;
      if (section.galleries.some((item) => item.dataset === dataset) && pick("dataset").value !== dataset) {
        pick("dataset").value = dataset;
        fillViews();
      }
      if (method in shot().pictures) {
        pick("b").value = method;
        show();
        root.scrollIntoView();
        stage.focus({ preventScroll: true });
      }
    });
    fillViews();
  }

  groups.forEach(([group, section]) => setUp(group, section));
})();
