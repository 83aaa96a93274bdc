// What the page shows of a campaign: filters, order, columns and the open run; the address keeps it, so that it can be sent.

const CHOICES = ["verdict", "variant", "tag", "criterion"];
const START = { column: "verdict", down: false };

function noFilter() {
  return { text: "", verdict: "", variant: "", tag: "", criterion: "", ranges: new Map() };
}

// The measures that are shown unless others are chosen.
function usualMeasures(runs) {
  return runs.fields.filter((field) => field.main).map((field) => field.path);
}

function addressOf({ filter, sort, measures, run }, runs) {
  const words = new URLSearchParams();
  for (const name of ["text", ...CHOICES]) if (filter[name]) words.set(name, filter[name]);
  for (const [path, range] of filter.ranges) words.set(`range.${path}`, range.map((value) => (Number.isFinite(value) ? value : "")).join(".."));
  if (sort.column !== START.column || sort.down) words.set("sort", (sort.down ? "-" : "") + sort.column);
  if (measures.join() !== usualMeasures(runs).join()) words.set("columns", measures.join());
  if (run) words.set("run", run.id);
  return words.toString();
}

// What an address says; what it does not say is as at the start.
function viewOf(address, runs) {
  const words = new URLSearchParams(address);
  const filter = noFilter();
  for (const name of ["text", ...CHOICES]) filter[name] = words.get(name) || "";
  for (const [name, value] of words) {
    if (!name.startsWith("range.")) continue;
    const [low, high] = value.split("..");
    filter.ranges.set(name.slice(6), [low ? Number(low) : -Infinity, high ? Number(high) : Infinity]);
  }
  const sort = words.get("sort");
  const chosen = words.has("columns") ? words.get("columns").split(",") : usualMeasures(runs);
  return {
    filter,
    sort: sort ? { column: sort.replace(/^-/, ""), down: sort.startsWith("-") } : START,
    measures: chosen.filter((path) => runs.fieldOf.has(path)),
    run: runs.byId.get(words.get("run")) || null,
  };
}
