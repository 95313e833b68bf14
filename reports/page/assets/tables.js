"use strict";
/* Sortable tables. Without scripts they stand as they are. */
(function () {
  /* The number that a cell begins with ("27.20¹ ± 0.1", "−0.3", "1/6,158"), or NaN. */
  function number(text) {
    const plain = text.trim().replace(/,/g, "").replace("−", "-");
    return plain.startsWith("1/") ? 1 / parseFloat(plain.slice(2)) : parseFloat(plain);
  }

  function value(cell) {
    if (cell.matches("th, .runs")) return cell.textContent.trim();
    return number((cell.querySelector("b") || cell).textContent);
  }

  function compare(a, b) {
    if (typeof a === "string") return a.localeCompare(b, "en", { numeric: true });
    return a - b;
  }

  function sort(heading) {
    const table = heading.closest("table");
    const column = Array.from(heading.parentNode.children).indexOf(heading);
    const descending = heading.getAttribute("aria-sort") === "ascending";
    table.querySelectorAll("[aria-sort]").forEach((other) => other.removeAttribute("aria-sort"));
    heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const rows = Array.from(table.tBodies[0].rows).map((row) => ({ row, key: value(row.children[column]) }));
    const missing = rows.filter((item) => Number.isNaN(item.key)); // stays below, whatever the direction
    const present = rows.filter((item) => !Number.isNaN(item.key)).sort((a, b) => compare(a.key, b.key));
    if (descending) present.reverse();
    present.concat(missing).forEach((item) => table.tBodies[0].appendChild(item.row));
  }

  document.querySelectorAll(".sort").forEach((button) => {
    button.addEventListener("click", () => sort(button.closest("th")));
  });
})();
