"use strict";
/* Sortable tables, and the methods' colours beside their names. Without scripts the tables stand as they are. */
(function () {
  function value(row, column) {
    const cell = row.children[column];
    if (cell.dataset.value !== undefined) return Number(cell.dataset.value);
    return cell.classList.contains("number") ? NaN : cell.textContent.trim();
  }

  function compare(a, b) {
    if (typeof a === "string" || typeof b === "string") return String(a).localeCompare(String(b), "en", { numeric: true });
    return a - b;
  }

  function sort(heading) {
    const table = heading.closest("table");
    const column = Array.from(heading.parentNode.children).indexOf(heading);
    const descending = heading.getAttribute("aria-sort") === "ascending";
    table.querySelectorAll("[aria-sort]").forEach((other) => other.removeAttribute("aria-sort"));
    heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const body = table.tBodies[0];
    const rows = Array.from(body.rows).map((row) => ({ row, key: value(row, column) }));
    const missing = rows.filter((item) => Number.isNaN(item.key)); // stays below, whatever the direction
    const present = rows.filter((item) => !Number.isNaN(item.key)).sort((a, b) => compare(a.key, b.key));
    if (descending) present.reverse();
    present.concat(missing).forEach((item) => body.appendChild(item.row));
  }

  document.querySelectorAll(".sort").forEach((button) => {
    button.addEventListener("click", () => sort(button.closest("th")));
  });

  document.querySelectorAll("[data-section]").forEach((group) => {
    const styles = window.REPORT.sections[Number(group.dataset.section)].styles;
    group.querySelectorAll(".dot").forEach((dot) => {
      const style = styles[dot.dataset.method];
      if (style) dot.style.background = style.color;
    });
  });
})();
