// The run, unpacked: see report/packing.py for the container.

const KINDS = { int8: Int8Array, int16: Int16Array, int32: Int32Array };
const ABSENT = 5;

async function unpack(base64) {
  const text = atob(base64.trim());
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  const start = 4 + new DataView(buffer).getUint32(0, true);
  const content = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, start - 4)));
  const arrays = {};
  for (const each of content.arrays) arrays[each.name] = restore(buffer, start, each);
  return new Scene(content, arrays);
}

function restore(buffer, start, { kind, shape, offset, resolution, differences }) {
  const count = shape.reduce((a, b) => a * b, 1);
  const whole = Int32Array.from(new KINDS[kind](buffer, start + offset, count));
  const length = shape[shape.length - 1];
  for (let n = 0; n < differences; n++) {
    for (let i = 0; i < count; i++) if (i % length) whole[i] += whole[i - 1];
  }
  if (resolution === 1) return whole;
  const values = new Float32Array(count);
  for (let i = 0; i < count; i++) values[i] = whole[i] * resolution;
  return values;
}

// Agents, their motion and what was decided about them. A time is a position between frames, as 12.4.
class Scene {
  constructor(content, arrays) {
    Object.assign(this, content.run, { arrays, road: content.road, series: content.series });
    Object.assign(this, { agents: content.agents, takeovers: content.takeovers, paths: content.paths });
    Object.assign(this, { contacts: content.contacts, forecastTime: content.forecast.time });
    this.every = content.forecast.every;
    this.last = this.frames - 1;
    this.rows = new Map(this.agents.map((agent, row) => [agent.id, row]));
    this.ghostRows = new Map(content.ghosts.map((id, row) => [id, row]));
    this.forecasts = this.#forecastsByStep();
    this.egoRow = this.rows.has(this.ego) ? this.rows.get(this.ego) : -1;
  }

  #forecastsByStep() {
    const byStep = new Map();
    this.arrays.forecast_step.forEach((step, row) => {
      if (!byStep.has(step)) byStep.set(step, []);
      byStep.get(step).push(row);
    });
    return byStep;
  }

  frameOf(step) {
    return Math.min(Math.max(step - this.first, 0), this.last);
  }

  seconds(time) {
    return (this.first + time) * this.dt;
  }

  modeAt(row, time) {
    return this.arrays.mode[row * this.frames + Math.floor(time)];
  }

  // Pose of an agent between its two nearest steps; null where it is not on the road.
  pose(row, time) {
    return this.modeAt(row, time) === ABSENT ? null : this.#between("", row, time, (i) => this.arrays.mode[i] !== ABSENT);
  }

  ghost(id, time) {
    const row = this.ghostRows.get(id);
    const known = (i) => this.arrays.ghost_present[i] === 1;
    return row !== undefined && known(row * this.frames + Math.floor(time)) ? this.#between("ghost_", row, time, known) : null;
  }

  #between(prefix, row, time, known) {
    const i = row * this.frames + Math.floor(time);
    const part = time % 1;
    const j = part > 0 && known(i + 1) ? i + 1 : i;
    const value = (name) => (1 - part) * this.arrays[prefix + name][i] + part * this.arrays[prefix + name][j];
    return { x: value("x"), y: value("y"), yaw: value("yaw"), speed: value("speed") };
  }

  acceleration(row, time) {
    return this.arrays.acceleration[row * this.frames + Math.floor(time)];
  }

  takeoversAt(time) {
    return this.takeovers[Math.floor(time)];
  }

  takeoverOf(id, time) {
    return this.takeoversAt(time).find((each) => each.agent === id);
  }

  // Forecasts in force: [{row, points: [{x, y, sx, sy, rho}]}].
  forecastsAt(time) {
    const step = this.first + Math.floor(time);
    const rows = this.forecasts.get(step - (step % this.every)) || [];
    return rows.map((at) => ({ row: this.arrays.forecast_agent[at], points: this.#forecast(at) }));
  }

  #forecast(at) {
    const a = this.arrays;
    return this.forecastTime.map((_, k) => {
      const i = at * this.forecastTime.length + k;
      const spread = { sx: a.forecast_sigma_x[i], sy: a.forecast_sigma_y[i], rho: a.forecast_rho[i] };
      return { x: a.forecast_x[i], y: a.forecast_y[i], ...spread };
    });
  }
}
