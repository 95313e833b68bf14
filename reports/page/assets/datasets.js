"use strict";
/* One data set at a time: a choice in one place is taken over wherever the same data set exists. */
(function () {
  window.Report.groups.forEach(([group]) => {
    const selects = Array.from(group.querySelectorAll(".dataset-select"));
    selects.forEach((select) => select.addEventListener("change", (event) => {
      if (event.detail === "echo") return;
      const name = select.selectedOptions[0] ? select.selectedOptions[0].text : "";
      selects.filter((other) => other !== select).forEach((other) => {
        const option = Array.from(other.options).find((candidate) => candidate.text === name);
        if (option && !option.selected) {
          option.selected = true;
          other.dispatchEvent(new CustomEvent("change", { detail: "echo" }));
        }
      });
    }));
  });
})();
