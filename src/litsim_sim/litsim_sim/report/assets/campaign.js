// The page of a campaign: filters, table, distributions and the panel of one run, all of one state, which the address keeps.

const $$ = (id) => document.getElementById(id);
const PICTURE = { width: 132, height: 50, large: { width: 420, height: 147 } };
const TALL = 58; // [px] of a row with a picture
const LOW = 34; // of one without
const LEAD = 1; // [s] before the moment of its picture, from which a run is played
const CHOICES = ["verdict", "row", "tag", "criterion"];
const START = { column: "verdict", down: false };

class Campaign {
  constructor(runs) {
    this.runs = runs;
    this.painter = new Painter(runs);
    this.pictured = runs.runs.some((run) => run.picture || run.steps);
    this.filter = { text: "", verdict: "", row: "", tag: "", criterion: "", ranges: new Map() };
    this.sort = START;
    this.measures = runs.fields.filter((field) => field.main).map((field) => field.path);
    this.selected = [];
    this.run = null;
    this.table = new RunTable($$("runs"), {
      height: this.pictured ? TALL : LOW,
      sorted: (column) => this.sortBy(column),
      opened: (id) => this.open(this.runs.byId.get(id)),
    });
    this.charts = new Distributions($$("distributions"), runs, (path, range) => this.setRange(path, range));
    this.panel = new Panel($$("panel"), this);
    this.#controls();
    this.#recall();
    // An address that leads to a place on the page is no view.
    addEventListener("hashchange", () => $$(location.hash.slice(1)) || this.#recall());
    document.addEventListener("keydown", (event) => this.#key(event));
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
    this.setFilter({ text: "", verdict: "", row: "", tag: "", criterion: "", ranges: new Map() });
  }

  // A second time the other way round.
  sortBy(column) {
    const again = this.sort.column === column;
    this.sort = { column, down: again ? !this.sort.down : false };
    this.#columns();
    this.#list();
  }

  choose(path, wanted) {
    this.measures = this.runs.fields.map((field) => field.path).filter((each) => (each === path ? wanted : this.measures.includes(each)));
    this.#columns();
    this.show();
  }

  show() {
    this.#list();
    this.charts.show(this.selected, this.filter.ranges);
    this.#said();
  }

  #list() {
    this.selected = this.runs.sort(this.runs.select(this.filter), this.sort);
    this.table.show(this.selected);
    this.#keep();
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
    const { runs } = this;
    const text = (of) => (cell, run) => this.#text(cell, of(run));
    const columns = [
      { id: "picture", title: "", width: PICTURE.width + 14, draw: (cell, run) => this.#picture(cell, run) },
      { id: "verdict", title: "verdict", width: 86, sorts: true, draw: (cell, run) => this.#verdict(cell, run) },
      { id: "row", title: "row", width: 140, sorts: true, draw: text((run) => runs.rows[run.row]) },
      { id: "name", title: "run", width: 176, sorts: true, draw: (cell, run) => this.#name(cell, run) },
      { id: "tags", title: "tags", width: 110, sorts: true, draw: (cell, run) => this.#tags(cell, run) },
      { id: "reason", title: "reason", width: 250, sorts: true, draw: (cell, run) => this.#text(cell, run.short, run.reason) },
      { id: "links", title: "open", width: 92, draw: (cell, run) => addLinks(cell, run) },
      ...this.measures.map((path) => this.#measure(path)),
      { id: "wall", title: "wall time [s]", width: 84, sorts: true, number: true, draw: text((run) => read(run.wall, 1)) },
    ];
    const shown = { picture: this.pictured, tags: runs.tags.length > 0, links: runs.runs.some((run) => run.report || run.log) };
    this.table.setColumns(columns.filter(({ id }) => shown[id] !== false), this.sort);
    this.charts.setFields(this.measures);
    this.#menu();
  }

  #measure(path) {
    const field = this.runs.fieldOf.get(path);
    const draw = (cell, run) => {
      cell.textContent = read(this.runs.value(run, path), field.digits);
      if (run.criteria.some((each) => !each.passed && this.runs.criteria[each.criterion].field === path)) cell.classList.add("missed");
    };
    return { id: path, title: field.label, hint: path, width: 92, sorts: true, number: true, draw };
  }

  #text(cell, text, more = text) {
    make("div", "clamp", cell, text || "–").title = more;
  }

  #picture(cell, run) {
    if (run.picture || run.steps) this.painter.paint(make("canvas", "thumbnail", cell), run, PICTURE.width, PICTURE.height);
  }

  #verdict(cell, run) {
    make("span", `badge ${run.verdict}`, cell, run.verdict);
  }

  #name(cell, run) {
    const button = make("button", "run clamp", cell);
    run.name.split("/").forEach((part, at) => button.append(...(at ? ["/", document.createElement("wbr")] : []), part));
    button.type = "button";
    button.title = `${run.name}: details`;
  }

  #tags(cell, run) {
    const holder = make("div", "clamp", cell);
    for (const tag of run.tags) make("span", "tag", holder, this.runs.tags[tag]);
  }

  #controls() {
    const { runs } = this;
    const options = { verdict: [NOT_PASSED, ...WORST_FIRST], row: runs.rows, tag: runs.tags, criterion: [...new Set(runs.criteria.map(({ name }) => name))] };
    for (const name of CHOICES) {
      for (const each of options[name]) make("option", "", $$(name), each).value = each;
      $$(name).closest("label").hidden = options[name].length < 2 && name !== "criterion";
      $$(name).addEventListener("change", () => this.setFilter({ [name]: $$(name).value }));
    }
    $$("text").addEventListener("input", () => this.setFilter({ text: $$("text").value }));
    for (const { path, label } of runs.fields) make("option", "", $$("measure"), label).value = path;
    $$("measure").addEventListener("change", () => this.#said());
    const bound = (id, otherwise) => ($$(id).value === "" ? otherwise : Number($$(id).value));
    for (const id of ["low", "high"]) {
      $$(id).addEventListener("change", () => this.setRange($$("measure").value, [bound("low", -Infinity), bound("high", Infinity)]));
    }
    $$("measure").closest("fieldset").hidden = !runs.fields.length;
    $$("clear").addEventListener("click", () => this.clear());
    $$("columns").hidden = !runs.fields.length;
    // Counts in the tables above lead to their runs.
    document.addEventListener("click", (event) => {
      const link = event.target.closest("[data-filter]");
      if (!link) return;
      this.clear();
      this.setFilter(JSON.parse(link.dataset.filter));
      $$("runs-title").scrollIntoView({ block: "start" });
    });
  }

  #menu() {
    const list = $$("measures");
    if (!list.childElementCount) {
      for (const { path, label } of this.runs.fields) {
        const box = make("input", "", make("label", "", list));
        Object.assign(box, { type: "checkbox", value: path });
        box.after(label);
        box.parentElement.title = path;
        box.addEventListener("change", () => this.choose(path, box.checked));
      }
    }
    for (const box of list.querySelectorAll("input")) box.checked = this.measures.includes(box.value);
  }

  // What the controls and the line above the table say about the filters.
  #said() {
    const { filter, runs } = this;
    for (const name of [...CHOICES, "text"]) if ($$(name).value !== filter[name]) $$(name).value = filter[name];
    const range = filter.ranges.get($$("measure").value) || [-Infinity, Infinity];
    ["low", "high"].forEach((id, end) => ($$(id).value = Number.isFinite(range[end]) ? +range[end].toPrecision(6) : ""));
    const counts = WORST_FIRST.map((verdict) => [this.selected.filter((run) => run.verdict === verdict).length, verdict]);
    const told = counts.filter(([count]) => count).map(([count, verdict]) => `${count} ${verdict}`);
    $$("shown").textContent = `${this.selected.length} of ${runs.runs.length} runs${told.length ? `: ${told.join(", ")}` : ""}`;
    const chips = CHOICES.filter((name) => filter[name]).map((name) => [`${name}: ${filter[name]}`, () => this.setFilter({ [name]: "" })]);
    if (filter.text) chips.unshift([`text: ${filter.text}`, () => this.setFilter({ text: "" })]);
    for (const [path, [low, high]] of filter.ranges) {
      const number = (value) => String(+value.toPrecision(4));
      const between = low === -Infinity ? `≤ ${number(high)}` : high === Infinity ? `≥ ${number(low)}` : `${number(low)} … ${number(high)}`;
      chips.push([`${runs.fieldOf.get(path)?.label ?? path}: ${between}`, () => this.setRange(path, [-Infinity, Infinity])]);
    }
    $$("chips").replaceChildren(
      ...chips.map(([text, drop]) => {
        const chip = make("button", "chip", null, `${text} ✕`);
        chip.type = "button";
        chip.title = "drop this filter";
        chip.addEventListener("click", drop);
        return chip;
      }),
    );
    $$("clear").hidden = !chips.length;
  }

  // The state goes into the address, so that a view can be kept and sent.
  #keep() {
    const words = new URLSearchParams();
    for (const name of ["text", ...CHOICES]) if (this.filter[name]) words.set(name, this.filter[name]);
    for (const [path, range] of this.filter.ranges) words.set(`range.${path}`, range.map((value) => (Number.isFinite(value) ? value : "")).join(".."));
    if (this.sort.column !== START.column || this.sort.down) words.set("sort", (this.sort.down ? "-" : "") + this.sort.column);
    const usual = this.runs.fields.filter((field) => field.main).map((field) => field.path);
    if (this.measures.join() !== usual.join()) words.set("columns", this.measures.join());
    if (this.run) words.set("run", this.run.id);
    this.kept = words.toString();
    history.replaceState(null, "", this.kept ? `#${this.kept}` : location.pathname + location.search);
  }

  #recall() {
    const words = new URLSearchParams(location.hash.slice(1));
    for (const name of ["text", ...CHOICES]) this.filter[name] = words.get(name) || "";
    this.filter.ranges = new Map();
    for (const [name, value] of words) {
      if (!name.startsWith("range.")) continue;
      const [low, high] = value.split("..");
      this.filter.ranges.set(name.slice(6), [low ? Number(low) : -Infinity, high ? Number(high) : Infinity]);
    }
    const sort = words.get("sort");
    if (sort) this.sort = { column: sort.replace(/^-/, ""), down: sort.startsWith("-") };
    if (words.has("columns")) this.measures = words.get("columns").split(",").filter((path) => this.runs.fieldOf.has(path));
    this.#columns();
    const run = this.runs.byId.get(words.get("run")) || null;
    this.run = run;
    this.show();
    this.panel.show(run);
    if (run) this.table.reveal(run);
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

function addLinks(host, run) {
  const links = [];
  const start = run.picture ? `#t=${Math.max(run.picture.step * run.dt - LEAD, 0).toFixed(1)}` : "";
  if (run.report) links.push([run.report + start, "play"]);
  if (run.log) links.push([run.log, "log"]);
  for (const [address, text] of links) {
    const link = make("a", "open", host, text);
    Object.assign(link, { href: address, target: "_blank", rel: "noopener" });
  }
  if (!links.length) host.append("–");
}
