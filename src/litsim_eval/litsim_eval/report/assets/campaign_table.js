// The table of runs: however many there are, only those on the screen are elements of the page.

const SPARE = 6; // rows beyond the edges

class RunTable {
  // columns: [{id, title, hint, width, number, draw(cell, run)}]; sorted(column) and opened(run) are called back.
  // nothing: what is said where there are no runs to show.
  constructor(box, { height, sorted, opened, nothing }) {
    Object.assign(this, { box, height, sorted, opened, nothing, runs: [], columns: [], drawn: [0, 0], current: null });
    this.table = make("table", "", box);
    this.head = make("tr", "", make("thead", "", this.table));
    this.body = make("tbody", "", this.table);
    this.none = make("p", "none", box);
    box.addEventListener("scroll", () => this.#fill());
    new ResizeObserver(() => this.#fill()).observe(box);
    this.body.addEventListener("click", (event) => {
      const row = event.target.closest("tr[data-id]");
      if (row && !event.target.closest("a")) this.opened(row.dataset.id);
    });
  }

  setColumns(columns, sort) {
    this.columns = columns;
    this.table.style.width = `${columns.reduce((sum, column) => sum + column.width, 0)}px`;
    this.head.replaceChildren(...columns.map((column) => this.#heading(column, sort)));
    this.show(this.runs);
  }

  #heading(column, sort) {
    const cell = document.createElement("th");
    cell.scope = "col";
    cell.style.width = `${column.width}px`;
    cell.dataset.column = column.id;
    if (column.number) cell.className = "number";
    if (!column.sorts) {
      make("span", "", cell, column.title);
      return cell;
    }
    const button = make("button", "", cell, column.title);
    button.type = "button";
    button.title = column.hint || `sort by ${column.title}`;
    button.addEventListener("click", () => this.sorted(column.id));
    if (sort.column === column.id) cell.setAttribute("aria-sort", sort.down ? "descending" : "ascending");
    return cell;
  }

  show(runs) {
    this.runs = runs;
    this.box.scrollTop = 0;
    this.table.setAttribute("aria-rowcount", runs.length + 1);
    this.none.textContent = runs.length ? "" : this.nothing;
    this.drawn = null;
    this.#fill();
  }

  // The row of a run, brought on the screen.
  reveal(run) {
    const at = this.runs.indexOf(run);
    this.current = run;
    if (at >= 0) {
      const [top, bottom] = [at * this.height, (at + 1) * this.height];
      const seen = this.box.clientHeight - this.head.offsetHeight;
      if (top < this.box.scrollTop) this.box.scrollTop = top;
      else if (bottom > this.box.scrollTop + seen) this.box.scrollTop = bottom - seen;
    }
    this.drawn = null;
    this.#fill();
  }

  #fill() {
    const first = Math.max(Math.floor(this.box.scrollTop / this.height) - SPARE, 0);
    const last = Math.min(Math.ceil((this.box.scrollTop + this.box.clientHeight) / this.height) + SPARE, this.runs.length);
    if (this.drawn && this.drawn[0] === first && this.drawn[1] === last) return;
    const focused = document.activeElement?.closest?.("tr[data-id]")?.dataset.id;
    this.drawn = [first, last];
    const rows = [];
    for (let at = first; at < last; at++) rows.push(this.#row(this.runs[at], at));
    this.body.replaceChildren(this.#space(first), ...rows, this.#space(this.runs.length - last));
    if (focused) rows.find((row) => row.dataset.id === focused)?.querySelector("button")?.focus({ preventScroll: true });
  }

  #row(run, at) {
    const row = document.createElement("tr");
    row.dataset.id = run.id;
    row.style.height = `${this.height}px`;
    row.setAttribute("aria-rowindex", at + 2);
    row.classList.toggle("current", run === this.current);
    for (const column of this.columns) {
      const cell = make("td", column.number ? "number" : "", row);
      column.draw(cell, run);
    }
    return row;
  }

  #space(count) {
    const row = document.createElement("tr");
    row.className = "space";
    row.style.height = `${count * this.height}px`;
    row.setAttribute("aria-hidden", "true");
    return row;
  }
}

// A new element with a class and text below a parent.
function make(name, style, parent, text) {
  const element = document.createElement(name);
  if (style) element.className = style;
  if (text !== undefined) element.textContent = text;
  if (parent) parent.append(element);
  return element;
}
