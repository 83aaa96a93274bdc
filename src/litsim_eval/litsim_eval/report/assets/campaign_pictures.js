// Pictures of runs: a scene from above, and below it a strip of time with takeovers and contacts.

const MODES = ["log", "policy", "ego", "handback", "own"]; // as in litsim_sim.core.colours
const STRIP = 7; // [px] height of the strip of time
const RING = 28; // around a contact, in the units of pictures

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

class Painter {
  constructor(content) {
    this.turn = content.picture_turn;
    this.readColours();
  }

  readColours() {
    this.colours = {};
    for (const name of ["ground", "road", "outline", "muted", "line", "conflict", "accent", "line-log"]) this.colours[name] = css(name);
    for (const mode of MODES) this.colours[mode] = css(`agent-${mode}`);
  }

  // Fill a canvas of the given size [px of the page] with what is known of a run.
  paint(canvas, run, width, height) {
    const scale = Math.min(devicePixelRatio || 1, 2);
    canvas.width = width * scale;
    canvas.height = height * scale;
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
    const c = canvas.getContext("2d");
    c.scale(scale, scale);
    if (run.picture) this.#scene(c, run.picture, width, height - STRIP);
    if (run.steps) this.#strip(c, run, width, height);
  }

  #scene(c, picture, width, height) {
    c.save();
    c.beginPath();
    c.roundRect(0, 0, width, height - 2, 3);
    c.clip();
    c.fillStyle = this.colours.ground;
    c.fillRect(0, 0, width, height);
    c.translate(width / 2, (height - 2) / 2);
    const scale = width / (2 * picture.size[0]);
    c.scale(scale, -scale);
    const px = 1 / scale;
    c.fillStyle = this.colours.road;
    c.beginPath();
    for (const ring of picture.road) this.#line(c, ring);
    c.fill("evenodd");
    this.#stroke(c, picture.log, this.colours["line-log"], px, [3 * px, 3 * px]);
    this.#stroke(c, picture.path, this.colours.ego, 1.5 * px, []);
    const egoLast = [...picture.boxes].sort((a, b) => (MODES[a[5]] === "ego") - (MODES[b[5]] === "ego"));
    for (const [x, y, yaw, length, w, mode] of egoLast) this.#box(c, x, y, yaw * this.turn, length, w, MODES[mode], px);
    if (picture.contact) this.#ring(c, picture.contact, px);
    c.restore();
  }

  #line(c, flat) {
    for (let i = 0; i + 1 < flat.length; i += 2) c[i ? "lineTo" : "moveTo"](flat[i], flat[i + 1]);
  }

  #stroke(c, lines, colour, width, dash) {
    c.beginPath();
    for (const line of lines) this.#line(c, line);
    c.setLineDash(dash);
    c.strokeStyle = colour;
    c.lineWidth = width;
    c.stroke();
    c.setLineDash([]);
  }

  #box(c, x, y, yaw, length, width, mode, px) {
    c.save();
    c.translate(x, y);
    c.rotate(yaw);
    c.fillStyle = this.colours[mode] || this.colours.muted;
    c.strokeStyle = this.colours.outline;
    c.lineWidth = 0.7 * px;
    c.fillRect(-length / 2, -width / 2, length, width);
    c.strokeRect(-length / 2, -width / 2, length, width);
    c.restore();
  }

  #ring(c, [x, y], px) {
    c.beginPath();
    c.arc(x, y, RING, 0, 2 * Math.PI);
    c.strokeStyle = this.colours.conflict;
    c.lineWidth = 1.6 * px;
    c.stroke();
  }

  #strip(c, run, width, height) {
    const x = (step) => (width * step) / run.steps;
    const top = height - STRIP + 1;
    c.fillStyle = this.colours.line;
    c.fillRect(0, top + 2, width, 2);
    c.fillStyle = this.colours.policy;
    for (const [from, to] of run.takeovers) c.fillRect(x(from), top + 1, Math.max(x(to) - x(from), 1), 4);
    c.fillStyle = this.colours.conflict;
    for (const step of run.contacts) c.fillRect(Math.min(x(step), width - 2.5), top - 1, 2.5, STRIP);
    if (run.picture) {
      c.fillStyle = this.colours.accent;
      c.beginPath();
      c.moveTo(x(run.picture.step) - 3, top - 1);
      c.lineTo(x(run.picture.step) + 3, top - 1);
      c.lineTo(x(run.picture.step), top + 3);
      c.fill();
    }
  }
}
