// Tables sort by a click on a column's head; a menu shows the rows of one set alone.
const collator = new Intl.Collator(undefined, { numeric: true });

function valueOf(row, column) {
  const cell = row.cells[column];
  return cell.dataset.value === undefined ? cell.textContent : Number(cell.dataset.value);
}

function compare(a, b) {
  if (typeof a === "string") return collator.compare(a, b);
  // What does not exist stands last, whichever way is up.
  return Number.isNaN(a) - Number.isNaN(b) || a - b;
}

for (const head of document.querySelectorAll("th button")) {
  head.addEventListener("click", () => {
    const cell = head.parentElement;
    const body = cell.closest("table").tBodies[0];
    const down = cell.getAttribute("aria-sort") === "ascending";
    for (const other of cell.parentElement.cells) other.removeAttribute("aria-sort");
    cell.setAttribute("aria-sort", down ? "descending" : "ascending");
    const rows = [...body.rows].sort((a, b) => {
      const [left, right] = [a, b].map((row) => valueOf(row, cell.cellIndex));
      const absent = Number.isNaN(left) || Number.isNaN(right);
      return compare(left, right) * (down && !absent ? -1 : 1);
    });
    body.append(...rows);
  });
}

const menu = document.querySelector("#set");
function show() {
  for (const row of document.querySelectorAll("tr[data-set]")) row.hidden = menu.value && row.dataset.set !== menu.value;
}
menu.addEventListener("change", show);
show();
