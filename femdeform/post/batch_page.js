"use strict";
// A click on a heading sorts the runs by that column, a second one turns the order round.
document.querySelectorAll("table.runs").forEach(function (table) {
  const body = table.tBodies[0];
  const headings = Array.from(table.tHead.rows[0].cells);
  function value(row, column) {
    const cell = row.cells[column];
    const number = cell.dataset.value === undefined ? NaN : Number(cell.dataset.value);
    return Number.isNaN(number) ? cell.textContent.trim() : number;
  }
  function compare(a, b) {
    const empty = (a === "") - (b === "");
    if (empty !== 0) { return { last: empty }; }
    if (typeof a === "number" && typeof b === "number") { return { order: a - b }; }
    return { order: String(a).localeCompare(String(b), undefined, { numeric: true }) };
  }
  headings.forEach(function (heading, column) {
    if (heading.classList.contains("plain")) { return; }
    heading.tabIndex = 0;
    function sort() {
      const down = heading.getAttribute("aria-sort") === "ascending";
      headings.forEach(function (other) { other.removeAttribute("aria-sort"); });
      heading.setAttribute("aria-sort", down ? "descending" : "ascending");
      Array.from(body.rows).sort(function (a, b) {
        const found = compare(value(a, column), value(b, column));
        return found.last || (down ? -found.order : found.order);
      }).forEach(function (row) { body.appendChild(row); });
    }
    heading.addEventListener("click", sort);
    heading.addEventListener("keydown", function (event) { if (event.key === "Enter") { sort(); } });
  });
});
