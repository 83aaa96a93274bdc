// The columns of the table of runs: how wide each is, and what it draws of a run.

const PICTURE = { width: 132, height: 50, large: { width: 420, height: 147 } };
const LEAD = 1; // [s] before the moment of its picture, from which a run is played

// The columns that there is anything to show in; `measures` are paths of fields.
function columnsOf(runs, measures, painter) {
  const picture = (cell, run) => {
    if (run.picture || run.steps) painter.paint(make("canvas", "thumbnail", cell), run, PICTURE.width, PICTURE.height);
  };
  const columns = [
    { id: "picture", title: "", width: PICTURE.width + 14, draw: picture },
    { id: "verdict", title: "verdict", width: 86, sorts: true, draw: (cell, run) => make("span", `badge ${run.verdict}`, cell, run.verdict) },
    { id: "name", title: "run", width: 176, sorts: true, draw: drawName },
    { id: "tags", title: "tags", width: 130, sorts: true, draw: (cell, run) => drawTags(cell, run.tags.map((tag) => runs.tags[tag])) },
    { id: "reason", title: "what happened", width: 268, sorts: true, draw: (cell, run) => drawText(cell, run.reason, run.reason) },
    { id: "links", title: "open", width: 92, draw: addLinks },
    ...measures.map((path) => measureColumn(runs, path)),
  ];
  const links = runs.runs.some((run) => run.report || run.log);
  const shown = { picture: runs.pictured, tags: runs.tags.length > 0, links };
  return columns.filter(({ id }) => shown[id] !== false);
}

// A value that misses its criterion is marked.
function measureColumn(runs, path) {
  const field = runs.fieldOf.get(path);
  const draw = (cell, run) => {
    cell.textContent = read(runs.value(run, path), field.digits);
    if (run.failed.some((each) => runs.criteria[each].field === path)) cell.classList.add("missed");
  };
  const hint = field.about ? `${path}: ${field.about}` : path;
  return { id: path, title: field.label, hint, width: 84, sorts: true, number: true, draw };
}

function drawText(cell, text, more = text) {
  make("div", "clamp", cell, text || "–").title = more;
}

// The parts of a name stay whole where it is broken.
function drawName(cell, run) {
  const button = make("button", "run clamp", cell);
  run.name.split("/").forEach((part, at) => button.append(...(at ? ["/", document.createElement("wbr")] : []), part));
  button.type = "button";
  button.title = `${run.name}: details`;
}

function drawTags(cell, tags) {
  const holder = make("div", "clamp", cell);
  for (const tag of tags) make("span", "tag", holder, tag);
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
