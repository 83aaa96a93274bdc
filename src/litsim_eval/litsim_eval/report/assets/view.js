// The bird's-eye view. World coordinates are metres, y up; the camera turns the road of the ego to the right.

const ROUND = new Set(["pedestrian", "bicycle"]);
const COLOURS = ["log", "policy", "ego", "handback", "own"]; // by mode; CSS variables --agent-*
const NAMES = ["log", "taken over", "ego", "handing back", "own intent"];
const SCALES = [0.3, 80]; // pixels a metre

class BirdView {
  constructor(canvas, scene) {
    Object.assign(this, { canvas, scene, shows: { plan: true, ghosts: true, forecasts: false, conflicts: false } });
    Object.assign(this, { context: canvas.getContext("2d"), selected: null, hovered: null, following: true });
    this.camera = { x: 0, y: 0, scale: 7, rotation: this.#direction() };
    this.surfaces = scene.road.lanes.map(({ width, line }) => ({ width, path: worldPath(line) }));
    this.lines = scene.road.lines.map(({ dashed, line }) => ({ dashed, path: worldPath(line) }));
    this.stopLines = scene.signals.map(({ line }) => worldPath(line));
    this.paths = scene.paths.map(worldPath);
    this.readColours();
    this.#centre();
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    const read = (name) => style.getPropertyValue(name).trim();
    this.lightColours = Object.fromEntries(["red", "amber", "green"].map((name) => [name, read(`--signal-${name}`)]));
    this.lightColours[""] = read("--signal-none");
    this.agentColours = COLOURS.map((name) => read(`--agent-${name}`));
    this.colours = {};
    for (const name of ["ground", "road", "paint", "ink", "outline", "conflict", "accent", "halo"]) this.colours[name] = read(`--${name}`);
  }

  // Heading that lies to the right on the screen: where the ego goes in all.
  #direction() {
    const { scene } = this;
    const seen = [];
    for (let k = 0; k < scene.frames; k++) {
      const pose = scene.egoRow >= 0 && scene.pose(scene.egoRow, k);
      if (pose) seen.push(pose);
    }
    if (!seen.length) return 0;
    const [a, b] = [seen[0], seen[seen.length - 1]];
    return Math.hypot(b.x - a.x, b.y - a.y) > 5 ? Math.atan2(b.y - a.y, b.x - a.x) : a.yaw;
  }

  #centre() {
    const shown = [this.scene.egoRow, ...this.scene.agents.keys()].map((row) => row >= 0 && this.scene.pose(row, 0));
    const pose = shown.find(Boolean);
    if (pose) Object.assign(this.camera, { x: pose.x, y: pose.y });
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    this.ratio = window.devicePixelRatio || 1;
    this.width = clientWidth;
    this.height = clientHeight;
    this.canvas.width = Math.round(clientWidth * this.ratio);
    this.canvas.height = Math.round(clientHeight * this.ratio);
  }

  toScreen({ x, y }) {
    const { x: cx, y: cy, scale, rotation } = this.camera;
    const [cos, sin] = [Math.cos(rotation) * scale, Math.sin(rotation) * scale];
    return { x: this.width / 2 + cos * (x - cx) + sin * (y - cy), y: this.height / 2 + sin * (x - cx) - cos * (y - cy) };
  }

  toWorld({ x, y }) {
    const { x: cx, y: cy, scale, rotation } = this.camera;
    const [u, v] = [(x - this.width / 2) / scale, (y - this.height / 2) / scale];
    const [cos, sin] = [Math.cos(rotation), Math.sin(rotation)];
    return { x: cx + cos * u + sin * v, y: cy + sin * u - cos * v };
  }

  pan(dx, dy) {
    const to = this.toWorld({ x: this.width / 2 - dx, y: this.height / 2 - dy });
    Object.assign(this.camera, to);
  }

  zoom(factor, at = { x: this.width / 2, y: this.height / 2 }) {
    const before = this.toWorld(at);
    this.camera.scale = Math.min(Math.max(this.camera.scale * factor, SCALES[0]), SCALES[1]);
    if (this.following) return; // the ego stays in the middle
    const after = this.toWorld(at);
    this.camera.x += before.x - after.x;
    this.camera.y += before.y - after.y;
  }

  // Brings an agent into the view if it is outside or near the border.
  reveal(row, time) {
    const pose = this.scene.pose(row, time);
    if (!pose) return;
    if (this.following) this.#follow(time);
    const { x, y } = this.toScreen(pose);
    const outside = x < 40 || y < 40 || x > this.width - 40 || y > this.height - 40;
    if (outside) {
      this.following = false;
      Object.assign(this.camera, { x: pose.x, y: pose.y });
    }
  }

  agentAt(point, time) {
    const { x, y } = this.toWorld(point);
    const margin = 6 / this.camera.scale;
    let [best, nearest] = [null, Infinity];
    this.scene.agents.forEach((agent, row) => {
      const pose = this.scene.pose(row, time);
      if (!pose) return;
      const [cos, sin] = [Math.cos(pose.yaw), Math.sin(pose.yaw)];
      const [dx, dy] = [x - pose.x, y - pose.y];
      const inside = Math.abs(dx * cos + dy * sin) < agent.length / 2 + margin && Math.abs(dy * cos - dx * sin) < agent.width / 2 + margin;
      const far = Math.hypot(dx, dy);
      if (inside && far < nearest) [best, nearest] = [row, far];
    });
    return best;
  }

  #follow(time) {
    const pose = this.scene.egoRow >= 0 ? this.scene.pose(this.scene.egoRow, time) : null;
    if (pose) Object.assign(this.camera, { x: pose.x, y: pose.y });
  }

  draw(time) {
    if (this.following) this.#follow(time);
    const { context: c, colours } = this;
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.fillStyle = colours.ground;
    c.fillRect(0, 0, this.canvas.width, this.canvas.height);
    this.#inWorld();
    this.#drawRoad();
    this.#drawSignals(time);
    const records = this.scene.takeoversAt(time);
    const shown = records.filter((each) => this.shows.conflicts || each.agent === this.#selectedId());
    if (this.shows.forecasts) this.#drawForecasts(time);
    for (const record of shown) this.#drawPath(record);
    if (this.shows.plan) this.#drawPlan(this.scene.planAt(time));
    if (this.shows.ghosts) this.#drawGhosts(time);
    const poses = this.scene.agents.map((_, row) => this.scene.pose(row, time));
    poses.forEach((pose, row) => pose && this.#drawAgent(row, pose, time));
    for (const record of shown) if (record.state !== "own_intent") this.#drawConflict(record, poses);
    c.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.#drawLabels(poses, time);
    this.#drawScaleBar();
  }

  #selectedId() {
    return this.selected === null ? null : this.scene.agents[this.selected].id;
  }

  #inWorld() {
    const { x, y, scale, rotation } = this.camera;
    const [cos, sin] = [Math.cos(rotation) * scale * this.ratio, Math.sin(rotation) * scale * this.ratio];
    const [cx, cy] = [this.canvas.width / 2, this.canvas.height / 2];
    this.context.setTransform(cos, sin, sin, -cos, cx - cos * x - sin * y, cy - sin * x + cos * y);
  }

  #pixels(n) {
    return n / this.camera.scale;
  }

  #drawRoad() {
    const { context: c, colours } = this;
    c.lineJoin = "round";
    c.strokeStyle = colours.road;
    for (const { width, path } of this.surfaces) {
      c.lineWidth = width + this.#pixels(0.8); // no seams between lanes
      c.stroke(path);
    }
    c.strokeStyle = colours.paint;
    c.lineWidth = Math.max(0.14, this.#pixels(0.9));
    for (const { dashed, path } of this.lines) {
      c.setLineDash(dashed ? [3, 6] : []);
      c.stroke(path);
    }
    c.setLineDash([]);
  }

  #drawSignals(time) {
    const { context: c } = this;
    c.lineWidth = Math.max(0.8, this.#pixels(3));
    this.scene.lightsAt(time).forEach((light, k) => {
      c.strokeStyle = this.lightColours[light];
      c.stroke(this.stopLines[k]);
    });
  }

  #box({ x, y, yaw }, { length, width }) {
    const { context: c } = this;
    const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
    c.beginPath();
    for (const [u, v] of [[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]]) {
      c.lineTo(x + cos * u * length - sin * v * width, y + sin * u * length + cos * v * width);
    }
    c.closePath();
  }

  // Pedestrians are round, never smaller than a few pixels; bicycles are long and round.
  #outline(pose, agent) {
    if (!ROUND.has(agent.kind)) return this.#box(pose, agent);
    const least = agent.kind === "pedestrian" ? this.#pixels(3) : 0;
    const [long, wide] = [agent.length, agent.width].map((size) => Math.max(size / 2, least));
    this.context.beginPath();
    this.context.ellipse(pose.x, pose.y, long, wide, pose.yaw, 0, 2 * Math.PI);
  }

  #drawAgent(row, pose, time) {
    const { context: c, colours } = this;
    const agent = this.scene.agents[row];
    const mode = this.scene.modeAt(row, time);
    this.#outline(pose, agent);
    c.fillStyle = this.agentColours[mode];
    c.fill();
    const marked = row === this.selected || row === this.hovered;
    c.lineWidth = this.#pixels(marked ? 3 : 1);
    c.strokeStyle = marked ? colours.accent : colours.outline;
    c.stroke();
    if (agent.kind === "pedestrian") return;
    // The windscreen shows where the front is.
    const [cos, sin] = [Math.cos(pose.yaw), Math.sin(pose.yaw)];
    const [u, v] = [0.24 * agent.length, 0.36 * agent.width];
    c.beginPath();
    c.moveTo(pose.x + cos * u - sin * v, pose.y + sin * u + cos * v);
    c.lineTo(pose.x + cos * u + sin * v, pose.y + sin * u - cos * v);
    c.lineWidth = Math.max(0.35, this.#pixels(1));
    c.strokeStyle = colours.outline;
    c.stroke();
  }

  #drawGhosts(time) {
    const { context: c } = this;
    for (const id of this.scene.ghostRows.keys()) {
      const row = this.scene.rows.get(id);
      const mode = row === undefined ? ABSENT : this.scene.modeAt(row, time);
      const ghost = mode === ABSENT || mode === 0 ? null : this.scene.ghost(id, time);
      if (!ghost) continue;
      c.strokeStyle = this.agentColours[mode];
      c.lineWidth = this.#pixels(1.6);
      c.setLineDash([this.#pixels(4), this.#pixels(3)]);
      this.#box(ghost, this.scene.agents[row]);
      c.stroke();
      const pose = this.scene.pose(row, time);
      c.lineWidth = this.#pixels(1);
      c.setLineDash([this.#pixels(1.5), this.#pixels(3)]);
      c.beginPath();
      c.moveTo(pose.x, pose.y);
      c.lineTo(ghost.x, ghost.y);
      c.stroke();
    }
    c.setLineDash([]);
  }

  #drawForecasts(time) {
    const { context: c } = this;
    for (const { row, points } of this.scene.forecastsAt(time)) {
      const pose = this.scene.pose(row, time);
      if (!pose) continue;
      const colour = this.agentColours[this.scene.modeAt(row, time)];
      const strong = this.selected === null || this.selected === row;
      c.strokeStyle = c.fillStyle = colour;
      c.globalAlpha = strong ? 0.13 : 0.04;
      for (const point of points) {
        const { major, minor, angle } = ellipse(point);
        c.beginPath();
        c.ellipse(point.x, point.y, major, minor, angle, 0, 2 * Math.PI);
        c.fill();
      }
      c.globalAlpha = strong ? 1 : 0.3;
      c.lineWidth = this.#pixels(1.6);
      c.beginPath();
      c.moveTo(pose.x, pose.y);
      for (const { x, y } of points) c.lineTo(x, y);
      c.stroke();
    }
    c.globalAlpha = 1;
  }

  // The trajectory that the ego's stack has planned, with a bar where it is to stop.
  #drawPlan(plan) {
    if (!plan) return;
    const { context: c } = this;
    const { points, stop } = plan;
    c.strokeStyle = this.agentColours[2];
    c.lineWidth = Math.max(0.5, this.#pixels(2.4));
    c.globalAlpha = 0.75;
    c.beginPath();
    for (const { x, y } of points) c.lineTo(x, y);
    c.stroke();
    const [before, last] = points.slice(-2);
    if (stop && last) {
      const far = Math.hypot(last.x - before.x, last.y - before.y) || 1;
      const [u, v] = [(1.5 * (before.y - last.y)) / far, (1.5 * (last.x - before.x)) / far];
      c.beginPath();
      c.moveTo(last.x - u, last.y - v);
      c.lineTo(last.x + u, last.y + v);
      c.stroke();
    }
    c.globalAlpha = 1;
  }

  #drawPath({ path, goal, state }) {
    const { context: c } = this;
    c.strokeStyle = this.agentColours[state === "held" ? 1 : state === "own_intent" ? 4 : 3];
    c.lineWidth = this.#pixels(1.6);
    c.stroke(this.paths[path]);
    if (!goal) return;
    const r = this.#pixels(5);
    c.lineWidth = this.#pixels(2.4);
    c.beginPath();
    for (const s of [1, -1]) {
      c.moveTo(goal[0] - r, goal[1] - s * r);
      c.lineTo(goal[0] + r, goal[1] + s * r);
    }
    c.stroke();
  }

  #drawConflict({ agent, opponent, pose }, poses) {
    const { context: c } = this;
    const row = this.scene.rows.get(agent);
    const [from, to] = [poses[row], poses[this.scene.rows.get(opponent)]];
    c.strokeStyle = this.colours.conflict;
    c.lineWidth = this.#pixels(2);
    if (from && to) {
      c.setLineDash([this.#pixels(6), this.#pixels(3)]);
      c.beginPath();
      c.moveTo(from.x, from.y);
      c.lineTo(to.x, to.y);
      c.stroke();
      c.setLineDash([]);
    }
    if (!pose || row === undefined) return;
    this.#box({ x: pose[0], y: pose[1], yaw: pose[2] }, this.scene.agents[row]);
    c.stroke();
    c.globalAlpha = 0.25;
    c.fillStyle = this.colours.conflict;
    c.fill();
    c.globalAlpha = 1;
  }

  #drawLabels(poses, time) {
    const { context: c, colours } = this;
    c.font = "600 12px system-ui, sans-serif";
    c.textAlign = "center";
    c.textBaseline = "bottom";
    c.lineWidth = 3;
    c.lineJoin = "round";
    c.strokeStyle = colours.halo;
    c.fillStyle = colours.ink;
    poses.forEach((pose, row) => {
      if (!pose || (this.scene.modeAt(row, time) === 0 && row !== this.selected && row !== this.hovered)) return;
      const { x, y } = this.toScreen(pose);
      const agent = this.scene.agents[row];
      const up = Math.max(9, 0.5 * agent.width * this.camera.scale) + 3;
      const text = agent.id === this.scene.ego ? `ego ${agent.id}` : String(agent.id);
      c.strokeText(text, x, y - up);
      c.fillText(text, x, y - up);
    });
  }

  #drawScaleBar() {
    const { context: c, colours } = this;
    const metres = [1, 2, 5, 10, 20, 50, 100, 200, 500].find((m) => m * this.camera.scale > 60) || 1000;
    const [x, y, length] = [14, this.height - 14, metres * this.camera.scale];
    c.strokeStyle = c.fillStyle = colours.ink;
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(x, y - 5);
    c.lineTo(x, y);
    c.lineTo(x + length, y);
    c.lineTo(x + length, y - 5);
    c.stroke();
    c.textAlign = "left";
    c.font = "12px system-ui, sans-serif";
    c.fillText(`${metres} m`, x + 4, y - 3);
  }
}

function worldPath(flat) {
  const path = new Path2D();
  for (let i = 0; i + 1 < flat.length; i += 2) path.lineTo(flat[i], flat[i + 1]);
  return path;
}

// 1-sigma ellipse of a Gaussian in the plane.
function ellipse({ sx, sy, rho }) {
  const [a, b, d] = [sx * sx, rho * sx * sy, sy * sy];
  const [mean, half] = [0.5 * (a + d), Math.hypot(0.5 * (a - d), b)];
  return { major: Math.sqrt(mean + half), minor: Math.sqrt(Math.max(mean - half, 0)), angle: 0.5 * Math.atan2(2 * b, a - d) };
}
