// Plots over time in SVG; all share the time axis and a cursor.

const TICK_PIXELS = 45;
const MARGIN = { left: 34, right: 14, top: 6, bottom: 16 };

// lines: [{values, style, label, id}]; values are one a frame, null where there is nothing. Stacked lines are areas.
class Chart {
  constructor(host, scene, { title, unit, lines, stacked = false, digits = 1, empty = "", bounds = [] }, seek) {
    Object.assign(this, { scene, lines, stacked, digits, unit, empty, bounds });
    const figure = document.createElement("figure");
    const caption = document.createElement("figcaption");
    caption.innerHTML = `<b>${title}</b> <span class="unit">${unit}</span> `;
    this.readouts = lines.filter((line) => line.label).map((line) => this.#readout(caption, line));
    this.element = svg("svg", { class: "chart" });
    figure.append(caption, this.element);
    host.append(figure);
    this.#listen(seek);
    new ResizeObserver(() => this.render()).observe(this.element);
  }

  #readout(caption, line) {
    const label = document.createElement("span");
    label.className = `key ${line.style}`;
    const value = document.createElement("output");
    label.append(`${line.label} `, value);
    caption.append(label);
    return { line, value };
  }

  #listen(seek) {
    const jump = (event) => {
      const box = this.element.getBoundingClientRect();
      const part = (event.clientX - box.left - MARGIN.left) / (box.width - MARGIN.left - MARGIN.right);
      seek(Math.min(Math.max(part, 0), 1) * this.scene.last);
    };
    this.element.addEventListener("pointerdown", (event) => {
      this.element.setPointerCapture(event.pointerId);
      jump(event);
    });
    this.element.addEventListener("pointermove", (event) => event.buttons && jump(event));
  }

  // Seconds between two ticks of a time axis, so that their labels stay apart.
  static tickStep(seconds, pixels) {
    return [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800].find((step) => step * pixels >= TICK_PIXELS * seconds) ?? 3600;
  }

  render() {
    const { element, scene } = this;
    const [width, height] = [element.clientWidth, element.clientHeight];
    if (!width) return;
    element.replaceChildren();
    element.setAttribute("viewBox", `0 0 ${width} ${height}`); // keeps it whole on paper, where it is not drawn anew
    const [lowest, highest] = this.#range();
    const high = niceTop(Math.max(highest, -lowest));
    const low = lowest < 0 ? -high : 0;
    this.x = (frame) => MARGIN.left + (frame / Math.max(scene.last, 1)) * (width - MARGIN.left - MARGIN.right);
    const y = (value) => height - MARGIN.bottom - ((value - low) / (high - low)) * (height - MARGIN.top - MARGIN.bottom);
    const past = this.x(scene.frameOf(scene.history));
    svg("rect", { x: MARGIN.left, y: MARGIN.top, width: past - MARGIN.left, height: y(low) - MARGIN.top, class: "history" }, element);
    for (const value of [low, (low + high) / 2, high]) {
      svg("line", { x1: MARGIN.left, x2: width - MARGIN.right, y1: y(value), y2: y(value), class: "grid" }, element);
      svg("text", { x: MARGIN.left - 5, y: y(value) + 4, class: "tick end" }, element).textContent = +value.toFixed(2);
    }
    const step = Chart.tickStep(scene.seconds(scene.last) - scene.seconds(0), width - MARGIN.left - MARGIN.right);
    const from = Math.ceil(scene.seconds(0) / step) * step;
    for (let t = from; t <= scene.seconds(scene.last) + 1e-6; t += step) {
      const at = this.x(t / scene.dt - scene.first);
      svg("text", { x: at, y: height - 3, class: "tick middle" }, element).textContent = t ? t : "0 s";
    }
    for (const bound of this.bounds.filter((each) => each >= low && each <= high)) {
      svg("line", { x1: MARGIN.left, x2: width - MARGIN.right, y1: y(bound), y2: y(bound), class: "bound" }, element);
    }
    this.#drawLines(y);
    if (this.empty && !this.lines.some(({ values }) => values.some((v) => v !== null))) {
      svg("text", { x: width / 2, y: height / 2, class: "tick middle" }, element).textContent = this.empty;
    }
    this.cursor = svg("line", { y1: MARGIN.top, y2: y(low), class: "cursor" }, element);
    this.move(this.time || 0);
    this.select(this.selected ?? null);
  }

  // Smallest and largest value, 0 among them, and bounds that are not far beyond.
  #range() {
    let [low, high] = [0, 0];
    if (this.stacked) for (let k = 0; k < this.scene.frames; k++) high = Math.max(high, this.lines.reduce((sum, line) => sum + line.values[k], 0));
    else for (const { values } of this.lines) for (const value of values) [low, high] = [Math.min(low, value ?? 0), Math.max(high, value ?? 0)];
    const near = this.bounds.filter((bound) => Math.abs(bound) < 3 * Math.max(high, -low));
    return [Math.min(low, ...near), Math.max(high, ...near)];
  }

  #drawLines(y) {
    const below = new Array(this.scene.frames).fill(0);
    for (const line of this.lines) {
      if (this.stacked) {
        const top = line.values.map((value, k) => below[k] + value);
        const edge = (values, frames) => frames.map((k) => `${this.x(k).toFixed(1)},${y(values[k]).toFixed(1)}`).join("L");
        const frames = [...top.keys()];
        svg("path", { d: `M${edge(top, frames)}L${edge(below, frames.reverse())}Z`, class: `area ${line.style}` }, this.element);
        top.forEach((value, k) => (below[k] = value));
      } else {
        const path = svg("path", { d: trace(line.values, this.x, y), class: `line ${line.style}` }, this.element);
        if (line.id !== undefined) path.dataset.agent = line.id;
      }
    }
  }

  move(time) {
    this.time = time;
    if (!this.cursor) return;
    for (const side of ["x1", "x2"]) this.cursor.setAttribute(side, this.x(time).toFixed(1));
    for (const { line, value } of this.readouts) {
      const now = line.values[Math.floor(time)];
      value.textContent = now === null || now === undefined ? "–" : now.toFixed(this.digits);
    }
  }

  select(id) {
    this.selected = id;
    for (const path of this.element.querySelectorAll("[data-agent]")) path.classList.toggle("selected", Number(path.dataset.agent) === id);
  }
}

// Path of a line with gaps where values are null; a value alone becomes a dot.
function trace(values, x, y) {
  let d = "";
  values.forEach((value, k) => {
    if (value === null) return;
    const before = k > 0 && values[k - 1] !== null;
    const alone = !before && (k + 1 >= values.length || values[k + 1] === null);
    d += `${before ? "L" : "M"}${x(k).toFixed(1)},${y(value).toFixed(1)}${alone ? "h0.1" : ""}`;
  });
  return d;
}

function niceTop(high) {
  if (!(high > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(high));
  return power * [1, 1.2, 1.6, 2, 3, 4, 5, 6, 8, 10].find((m) => m * power >= high * 0.999);
}

function makeCharts(host, scene, seek) {
  const { series } = scene;
  const speed = [
    { values: series.speed_log, style: "log-line", label: "log" },
    { values: series.speed, style: "ego", label: `ego (${scene.ego_by})` },
  ];
  const ttc = [
    { values: series.ttc_others, style: "policy", label: "taken over" },
    { values: series.ttc_ego, style: "ego", label: "ego" },
  ];
  const far = Object.entries(series.deviation).map(([id, values]) => ({ values, style: "policy", id: Number(id) }));
  const off = [{ values: series.policy, style: "policy", label: "taken over" }];
  if (series.own.some(Boolean)) off.push({ values: series.own, style: "own", label: "own intent" });
  if (series.handback.some(Boolean)) off.push({ values: series.handback, style: "handback", label: "handing back" });
  const ofEgo = (values) => [{ values, style: "ego", label: "ego" }];
  const within = (unit, [low, high]) => `${unit}, in comfort from ${low} to ${high}`;
  const { bounds } = scene;
  const offLog = off.some(({ values }) => values.some(Boolean));
  const background = [
    { title: "Off their log by", unit: "m, a line an agent", lines: far, empty: "no agent left its log" },
    { title: "Agents off their log", unit: "", lines: off, stacked: true, digits: 0 },
  ];
  return [
    { title: "Speed of the ego", unit: "m/s", lines: speed },
    { title: "Acceleration", unit: within("m/s²", bounds.acceleration), lines: ofEgo(series.acceleration), bounds: bounds.acceleration },
    { title: "Jerk", unit: within("m/s³", bounds.jerk), lines: ofEgo(series.jerk), bounds: bounds.jerk },
    { title: "Yaw rate", unit: within("rad/s", bounds.yaw_rate), lines: ofEgo(series.yaw_rate), bounds: bounds.yaw_rate, digits: 2 },
    { title: "Headway", unit: "s", lines: ofEgo(series.headway), empty: "never below 6 s" },
    { title: "TTC with the leader", unit: "s", lines: ttc, empty: "never below 12 s", bounds: bounds.ttc },
    ...(offLog ? background : []),
  ].map((description) => new Chart(host, scene, description, seek));
}
