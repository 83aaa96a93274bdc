// The page of a campaign: one view of it, which filters, table, distributions and the panel of a run share.

const $$ = (id) => document.getElementById(id);
const TALL = 58; // [px] of a row with a picture
const LOW = 34; // of one without

class Campaign {
  constructor(runs) {
    this.runs = runs;
    this.painter = new Painter(runs);
    this.table = new RunTable($$("runs"), {
      height: runs.pictured ? TALL : LOW,
      sorted: (column) => this.sortBy(column),
      opened: (id) => this.open(this.runs.byId.get(id)),
      nothing: runs.runs.length ? "No run passes these filters." : "No run is over yet.",
    });
    this.bar = new FilterBar(runs, this);
    this.charts = new Distributions($$("distributions"), runs, (path, range) => this.setRange(path, range));
    this.panel = new Panel($$("panel"), this);
    this.#recall();
    this.#listen();
  }

  #listen() {
    // An address that leads to a place on the page is no view.
    addEventListener("hashchange", () => $$(location.hash.slice(1)) || this.#recall());
    document.addEventListener("keydown", (event) => this.#key(event));
    // Counts in the tables above lead to their runs.
    document.addEventListener("click", (event) => {
      const count = event.target.closest("[data-filter]");
      if (!count) return;
      this.setFilter({ ...noFilter(), ...JSON.parse(count.dataset.filter) });
      $$("runs-title").scrollIntoView({ block: "start" });
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.painter.readColours();
      this.table.show(this.selected);
      this.panel.show(this.run);
    });
  }

  // Change some of the filters, and show what is left.
  setFilter(changes) {
    Object.assign(this.filter, changes);
    this.show();
  }

  setRange(path, [low, high]) {
    if (low === -Infinity && high === Infinity) this.filter.ranges.delete(path);
    else this.filter.ranges.set(path, [low, high]);
    $$("measure").value = path;
    this.show();
  }

  clear() {
    this.setFilter(noFilter());
  }

  // A second time the other way round.
  sortBy(column) {
    this.sort = { column, down: this.sort.column === column ? !this.sort.down : false };
    this.#columns();
    this.#list();
  }

  // Show a measure, or no longer; they keep their order.
  choose(path, wanted) {
    const paths = this.runs.fields.map((field) => field.path);
    this.measures = paths.filter((each) => (each === path ? wanted : this.measures.includes(each)));
    this.#columns();
    this.show();
  }

  show() {
    this.#list();
    this.charts.show(this.selected, this.filter.ranges);
    this.bar.show(this.filter, this.selected);
  }

  open(run) {
    this.run = run;
    this.panel.show(run);
    this.table.reveal(run);
    this.#keep();
  }

  close() {
    const from = this.run;
    this.open(null);
    document.querySelector(`#runs tr[data-id="${CSS.escape(from?.id ?? "")}"] button`)?.focus({ preventScroll: true });
  }

  // The run so many places further on in the table.
  step(count) {
    const at = this.selected.indexOf(this.run);
    const next = this.selected[at < 0 ? 0 : Math.min(Math.max(at + count, 0), this.selected.length - 1)];
    if (next) this.open(next);
  }

  #columns() {
    this.table.setColumns(columnsOf(this.runs, this.measures, this.painter), this.sort);
    this.charts.setFields(this.measures);
    this.bar.tick(this.measures);
  }

  #list() {
    this.selected = this.runs.sort(this.runs.select(this.filter), this.sort);
    this.table.show(this.selected);
    this.#keep();
  }

  #keep() {
    const address = addressOf(this, this.runs);
    history.replaceState(null, "", address ? `#${address}` : location.pathname + location.search);
  }

  #recall() {
    Object.assign(this, viewOf(location.hash.slice(1), this.runs));
    this.#columns();
    this.show();
    this.panel.show(this.run);
    if (this.run) this.table.reveal(this.run);
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Escape" && this.run) return this.close();
    if (event.target.closest("input, select, textarea")) return;
    if (event.key === "/") {
      event.preventDefault();
      $$("text").focus();
    }
    if (event.key === "j" || event.key === "k") this.step(event.key === "j" ? 1 : -1);
  }
}
