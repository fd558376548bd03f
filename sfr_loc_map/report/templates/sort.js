"use strict";
// A click on a heading, or Enter, sorts the rows by this column: first in ascending, then in descending order.
(function () {
  const valueOf = (row, column) => {
    const cell = row.cells[column], text = cell.textContent.trim();
    const number = cell.dataset.value === undefined ? parseFloat(text.replace(/^[^\d.+-]+/, "")) : Number(cell.dataset.value);
    return Number.isNaN(number) ? text : number;
  };
  const before = (a, b) => {
    if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1; // unknown values are last
    return typeof a === "number" ? a - b : a.localeCompare(b, undefined, { numeric: true });
  };
  for (const table of document.querySelectorAll(".table table")) {
    const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
    if (body.rows.length < 2) continue;
    heads.forEach((head, column) => {
      const sort = () => {
        const down = head.getAttribute("aria-sort") === "ascending", rows = [...body.rows];
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const keyed = rows.map((row) => [valueOf(row, column), row]);
        keyed.sort(([a], [b]) => (down && typeof a === typeof b ? -1 : 1) * before(a, b));
        body.append(...keyed.map(([, row]) => row));
      };
      head.tabIndex = 0;
      head.addEventListener("click", sort);
      head.addEventListener("keydown", (event) => event.key === "Enter" && sort());
    });
  }
})();
