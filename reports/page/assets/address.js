"use strict";
/* What is chosen in the page's controls stands in its address, so that a link shows what its sender saw. */
(function () {
  const controls = [];
  window.Report.groups.forEach(([group], number) => {
    group.querySelectorAll(".controls select, .toggles input, .curve-y").forEach((control) => {
      const name = control.classList[0];
      const same = controls.filter((other) => other.key.startsWith(`${number}.${name}.`)).length;
      controls.push({ key: `${number}.${name}.${same}`, control, first: null });
    });
  });
  const value = (control) => (control.type === "checkbox" ? String(control.checked) : control.value);

  function put(control, wanted) {
    if (control.type === "checkbox") control.checked = wanted === "true";
    else if (Array.from(control.options).some((option) => option.value === wanted)) control.value = wanted;
    else return;
    control.dispatchEvent(new Event("change"));
  }

  function write() {
    const query = new URLSearchParams();
    controls.filter((item) => value(item.control) !== item.first).forEach((item) => query.set(item.key, value(item.control)));
    const text = query.toString();
    try {
      history.replaceState(null, "", (text ? `?${text}` : location.pathname) + location.hash);
    } catch (error) {
      /* A browser that lets no file's address change. */
    }
  }

  controls.forEach((item) => { item.first = value(item.control); });
  const asked = new URLSearchParams(location.search);
  /* In the order of the page: a data set fills the choices behind it. */
  controls.filter((item) => asked.has(item.key)).forEach((item) => put(item.control, asked.get(item.key)));
  controls.forEach((item) => item.control.addEventListener("change", write));
  document.addEventListener("click", () => setTimeout(write, 0));
  if (location.hash && document.querySelector(location.hash)) document.querySelector(location.hash).scrollIntoView();

  /* A link to something folded opens it. */
  function unfold() {
    const place = location.hash && document.getElementById(location.hash.slice(1));
    if (place && place.tagName === "DETAILS") place.open = true;
  }
  window.addEventListener("hashchange", unfold);
  unfold();
})();
