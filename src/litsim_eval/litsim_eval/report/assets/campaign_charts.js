// How the main measures are spread over the runs: a histogram for each variant, all of a measure on one axis.

const BINS = 28;
const BAND = { width: 200, height: 26 };

// Bins of some values: whole numbers have bins of their own; else what is far out joins the first or the last one, as
// `below` and `above` tell.
function binsOf(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const at = (part) => sorted[Math.round(part * (sorted.length - 1))];
  const [least, most] = [at(0), at(1)];
  if (sorted.every(Number.isInteger) && most - least < BINS) return { low: least - 0.5, width: 1, count: most - least + 1 };
  const cut = sorted.length > 100 && at(0.005) < at(0.995);
  const [low, high] = cut ? [at(0.005), at(0.995)] : [least, most];
  const width = (high - low) / BINS || 1;
  return { low, width, count: high > low ? BINS : 1, below: least < low, above: most > high };
}

function binOf(value, { low, width, count }) {
  return Math.min(Math.max(Math.floor((value - low) / width), 0), count - 1);
}

function median(values) {
  if (!values.length) return null;
  const sorted = [...values].sort((a, b) => a - b);
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
}

class Distributions {
  // picked(path, [low, high]) is called where somebody marks a stretch of an axis.
  constructor(host, runs, picked) {
    Object.assign(this, { host, runs, picked, paths: [], bins: new Map() });
  }

  setFields(paths) {
    this.paths = paths.filter((path) => {
      const numbers = this.#numbers(this.runs.runs, path);
      return numbers.length > 1 && numbers.some((value) => value !== numbers[0]);
    });
  }

  #numbers(runs, path) {
    return runs.map((run) => this.runs.value(run, path)).filter((value) => typeof value === "number");
  }

  show(selected, ranges) {
    const all = this.runs.variants.map((_, variant) => this.runs.runs.filter((run) => run.variant === variant));
    const some = this.runs.variants.map((_, variant) => selected.filter((run) => run.variant === variant));
    this.host.replaceChildren(...this.paths.map((path) => this.#figure(path, all, some, ranges.get(path))));
  }

  #figure(path, all, some, range) {
    const field = this.runs.fieldOf.get(path);
    if (!this.bins.has(path)) this.bins.set(path, binsOf(this.#numbers(this.runs.runs, path)));
    const bins = this.bins.get(path);
    const figure = document.createElement("figure");
    figure.dataset.path = path;
    make("figcaption", "", figure, field.label).title = path;
    this.runs.variants.forEach((name, variant) => this.#band(figure, field, bins, name, all[variant], some[variant], range));
    const axis = make("div", "axis", figure);
    const end = bins.low + bins.width * bins.count;
    const whole = Number.isInteger(bins.low + 0.5) && bins.width === 1;
    make("span", "", axis, (bins.below ? "≤ " : "") + read(whole ? bins.low + 0.5 : +bins.low.toPrecision(3), null));
    make("span", "", axis, (bins.above ? "≥ " : "") + read(whole ? end - 0.5 : +end.toPrecision(3), null));
    return figure;
  }

  #band(figure, field, bins, name, all, some, range) {
    const band = make("div", "band", figure);
    make("span", "name", band, name).title = name;
    const [whole, part] = [all, some].map((runs) => this.#numbers(runs, field.path));
    const picture = svg("svg", { viewBox: `0 0 ${BAND.width} ${BAND.height}`, preserveAspectRatio: "none" }, band);
    const [high, low] = [whole, part].map((values) => this.#counts(values, bins));
    const top = Math.max(...high, 1);
    this.#bars(picture, high, top, "all");
    this.#bars(picture, low, top, "some");
    const x = (value) => (BAND.width * (value - bins.low)) / (bins.width * bins.count);
    if (range) {
      const [from, to] = range.map((value) => Math.min(Math.max(x(value), 0), BAND.width));
      svg("rect", { x: from, y: 0, width: Math.max(to - from, 1), height: BAND.height, class: "range" }, picture);
    }
    for (const limit of field.limits) {
      if (x(limit) >= 0 && x(limit) <= BAND.width) svg("line", { x1: x(limit), x2: x(limit), y1: 0, y2: BAND.height, class: "limit" }, picture);
    }
    const middle = median(part);
    make("span", "value", band, read(middle, field.digits));
    const lacking = all.length - whole.length;
    band.title = `${name}: median ${read(middle, field.digits)} over ${part.length} runs${lacking ? `; ${lacking} of all ${all.length} have no value` : ""}`;
    this.#listen(picture, field.path, bins);
  }

  #counts(values, bins) {
    const counts = new Array(bins.count).fill(0);
    for (const value of values) counts[binOf(value, bins)] += 1;
    return counts;
  }

  #bars(picture, counts, top, style) {
    const step = BAND.width / counts.length;
    const d = counts.map((count, bin) => {
      const height = count ? Math.max((BAND.height - 1) * (count / top), 1.5) : 0;
      return height ? `M${(bin * step + 0.4).toFixed(1)},${BAND.height}v${(-height).toFixed(1)}h${(step - 0.8).toFixed(1)}V${BAND.height}z` : "";
    });
    svg("path", { d: d.join(""), class: style }, picture);
  }

  // A press and a release mark the bins between them; the outermost bins reach on to all that lies beyond.
  #listen(picture, path, bins) {
    const bin = (event) => {
      const box = picture.getBoundingClientRect();
      return Math.min(Math.max(Math.floor(((event.clientX - box.left) / box.width) * bins.count), 0), bins.count - 1);
    };
    let start = null;
    picture.addEventListener("pointerdown", (event) => {
      picture.setPointerCapture(event.pointerId);
      start = bin(event);
    });
    picture.addEventListener("pointercancel", () => (start = null));
    picture.addEventListener("pointerup", (event) => {
      if (start === null) return;
      const [from, to] = [start, bin(event)].sort((a, b) => a - b);
      const low = from ? bins.low + from * bins.width : -Infinity;
      const high = to < bins.count - 1 ? bins.low + (to + 1) * bins.width : Infinity;
      this.picked(path, [low, high]);
    });
  }
}
