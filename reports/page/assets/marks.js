"use strict";
/* The methods' marks, by shape and color, wherever a method is named; and what the other scripts share. */
window.Report = (function () {
  /* Outlines in a box from -8 to 8, after plotly's symbols of the same names. */
  const SHAPES = {
    circle: "M-6,0a6,6 0 1,0 12,0a6,6 0 1,0 -12,0Z",
    square: "M-5.4,-5.4H5.4V5.4H-5.4Z",
    diamond: "M0,-7.2L7.2,0L0,7.2L-7.2,0Z",
    "diamond-tall": "M0,-8L4.8,0L0,8L-4.8,0Z",
    "triangle-up": "M0,-6.6L6.8,5.4H-6.8Z",
    "triangle-down": "M0,6.6L6.8,-5.4H-6.8Z",
    "triangle-left": "M-6.6,0L5.4,6.8V-6.8Z",
    "triangle-right": "M6.6,0L-5.4,6.8V-6.8Z",
    cross: "M-2.4,-6.8H2.4V-2.4H6.8V2.4H2.4V6.8H-2.4V2.4H-6.8V-2.4H-2.4Z",
    x: "M-6.6,-3.4L-3.4,-6.6L0,-3.2L3.4,-6.6L6.6,-3.4L3.2,0L6.6,3.4L3.4,6.6L0,3.2L-3.4,6.6L-6.6,3.4L-3.2,0Z",
    pentagon: "M0,-6.8L6.5,-2.1L4,5.5H-4L-6.5,-2.1Z",
    hexagon: "M0,-6.8L5.9,-3.4V3.4L0,6.8L-5.9,3.4V-3.4Z",
    hexagon2: "M-3.4,-5.9H3.4L6.8,0L3.4,5.9H-3.4L-6.8,0Z",
    octagon: "M-2.7,-6.4H2.7L6.4,-2.7V2.7L2.7,6.4H-2.7L-6.4,2.7V-2.7Z",
    star: "M0,-7.5L1.9,-2.4H7.2L2.9,0.9L4.5,6.2L0,3L-4.5,6.2L-2.9,0.9L-7.2,-2.4H-1.9Z",
  };

  function element(tag, properties, ...children) {
    const node = Object.assign(document.createElement(tag), properties);
    node.append(...children);
    return node;
  }

  /* An SVG of a method's mark, hollow where it failed somewhere. */
  function mark(style, hollow) {
    const space = "http://www.w3.org/2000/svg";
    const picture = document.createElementNS(space, "svg");
    const shape = document.createElementNS(space, "path");
    picture.setAttribute("viewBox", "-8 -8 16 16");
    picture.setAttribute("class", "shape");
    picture.setAttribute("aria-hidden", "true");
    shape.setAttribute("d", SHAPES[style.symbol]);
    shape.setAttribute("fill", hollow ? "none" : style.color);
    shape.setAttribute("stroke", hollow ? style.color : "currentColor");
    shape.setAttribute("stroke-width", hollow ? "2" : "0.6");
    picture.append(shape);
    return picture;
  }

  function fill(select, options, chosen) {
    select.replaceChildren(...options.map(([value, text]) => new Option(text, value, false, value === chosen)));
  }

  function escaped(text) {
    return String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  }

  /* [element, its section's data] of each section of the page. */
  const groups = Array.from(document.querySelectorAll("[data-section]")).map((group) => [group, window.REPORT.sections[Number(group.dataset.section)], Number(group.dataset.section)]);

  groups.forEach(([group, section]) => {
    group.querySelectorAll("i.mark").forEach((place) => {
      const style = section.styles[place.dataset.method];
      if (style) place.append(mark(style, false));
    });
  });

  return { element, escaped, fill, groups, mark };
})();
