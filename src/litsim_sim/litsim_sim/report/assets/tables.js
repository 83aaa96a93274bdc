// Tables that sort by the heading that is clicked; numbers as numbers, dashes last.

const worth = (row, column) => {
  const text = row.cells[column].textContent.trim();
  const value = parseFloat(text);
  return text === "–" ? Infinity : Number.isNaN(value) ? text : value;
};

function compare(a, b) {
  if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
  return typeof a === "number" && a !== Infinity ? -1 : a === Infinity ? 1 : typeof b === "number" && b !== Infinity ? 1 : -1;
}

for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) =>
    head.querySelector("button").addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      for (const each of heads) each.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const rows = [...table.tBodies[0].rows].sort((a, b) => (up ? 1 : -1) * compare(worth(a, column), worth(b, column)));
      table.tBodies[0].append(...rows);
    }),
  );
}
