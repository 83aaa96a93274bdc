// The runs of a campaign, and which of them pass a filter, in which order. Nothing here touches the page.

const WORST_FIRST = ["error", "failed", "passed"];
const NOT_PASSED = "not passed"; // a choice of the filter by verdict: failed or error

class Runs {
  // content: see report/campaign_content.py.
  constructor(content) {
    Object.assign(this, content);
    for (const run of this.runs) run.dt = this.dt;
    this.pictured = this.runs.some((run) => run.picture || run.steps);
    this.fieldOf = new Map(this.fields.map((field) => [field.path, field]));
    this.byId = new Map(this.runs.map((run) => [run.id, run]));
    this.alike = new Map(); // runs of the same case in other variants
    this.runs.forEach((run, index) => {
      run.index = index;
      run.failed = run.criteria.filter(({ passed }) => !passed).map(({ criterion }) => criterion);
      const told = [run.name, this.variants[run.variant], run.id, run.verdict, run.reason, ...run.tags.map((tag) => this.tags[tag])];
      run.said = [...told, ...run.failed.map((each) => this.criteria[each].name)].join("\n").toLowerCase();
      if (!this.alike.has(run.same)) this.alike.set(run.same, []);
      this.alike.get(run.same).push(run);
    });
  }

  value(run, path) {
    return this.fieldOf.has(path) ? this.fieldOf.get(path).values[run.index] : null;
  }

  // Every word of the text has to occur somewhere in what a run says of itself.
  select(filter) {
    const words = filter.text.toLowerCase().split(/\s+/).filter(Boolean);
    const ranges = [...filter.ranges];
    return this.runs.filter(
      (run) =>
        (filter.verdict === "" || run.verdict === filter.verdict || (filter.verdict === NOT_PASSED && run.verdict !== "passed")) &&
        (filter.variant === "" || this.variants[run.variant] === filter.variant) &&
        (filter.tag === "" || run.tags.some((tag) => this.tags[tag] === filter.tag)) &&
        (filter.criterion === "" || run.failed.some((each) => this.criteria[each].name === filter.criterion)) &&
        words.every((word) => run.said.includes(word)) &&
        ranges.every(([path, [low, high]]) => {
          const value = this.value(run, path);
          return value !== null && value >= low && value <= high;
        }),
    );
  }

  // What is sorted by: text, or a number; null where a run has none.
  key(run, column) {
    if (column === "verdict") return WORST_FIRST.indexOf(run.verdict);
    if (column === "variant") return run.variant;
    if (column === "name") return run.name;
    if (column === "tags") return run.tags.length ? run.tags.map((tag) => this.tags[tag]).join(" ") : null;
    if (column === "reason") return run.reason || null;
    return this.value(run, column);
  }

  // In place; runs that have nothing to sort by come last, either way; equal ones stay in the order of the campaign.
  sort(runs, { column, down }) {
    const sign = down ? -1 : 1;
    const keys = new Map(runs.map((run) => [run, this.key(run, column)]));
    const text = new Intl.Collator("en", { numeric: true });
    return runs.sort((a, b) => {
      const [x, y] = [keys.get(a), keys.get(b)];
      if (x === null || y === null) return (x === null) - (y === null) || a.index - b.index;
      const order = typeof x === "string" ? text.compare(x, y) : x - y;
      return sign * order || a.index - b.index;
    });
  }
}

function read(value, digits) {
  if (value === null || value === undefined) return "–";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value !== "number") return String(value);
  if (Number.isInteger(value)) return String(value);
  return digits === null ? String(+value.toPrecision(4)) : value.toFixed(digits);
}
