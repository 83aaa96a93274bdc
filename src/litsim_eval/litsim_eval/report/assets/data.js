// The run as the player reads it.

const ABSENT = 5;

// Agents, their motion and what was decided about them. A time is a position between frames, as 12.4.
class Scene {
  constructor(content) {
    Object.assign(this, content.run, { arrays: content.arrays, road: content.road, series: content.series });
    Object.assign(this, { agents: content.agents, takeovers: content.takeovers, paths: content.paths });
    Object.assign(this, { moments: content.moments, bounds: content.bounds });
    Object.assign(this, { contacts: content.contacts, forecastTime: content.forecast.time, signals: content.signals });
    this.every = content.forecast.every;
    this.plan = content.plan;
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

  // Whether the road is much longer from left to right than from top to bottom, as a motorway is.
  isFlat() {
    const points = this.road.lanes.flatMap(({ line }) => line);
    const extent = (values) => values.reduce((most, value) => Math.max(most, value), -Infinity) + values.reduce((most, value) => Math.max(most, -value), -Infinity);
    return points.length > 0 && extent(points.filter((_, k) => k % 2 === 0)) > 5 * extent(points.filter((_, k) => k % 2 === 1));
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

  // What each stop line shows: red, amber, green, or nothing.
  lightsAt(time) {
    return this.signals.map(({ shown }) => (shown.findLast(([frame]) => frame <= time) || [0, ""])[1]);
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

  // What the ego's stack has planned last, unless that is a second old: {points: [{x, y}], stop}, or null.
  planAt(time) {
    const { plan_step: steps, plan_end: ends, plan_x: x, plan_y: y } = this.arrays;
    const step = this.first + Math.floor(time);
    const at = steps.findLastIndex((each) => each <= step);
    if (at < 0 || (step - steps[at]) * this.dt > 1) return null;
    const points = [];
    for (let i = at > 0 ? ends[at - 1] : 0; i < ends[at]; i++) points.push({ x: x[i], y: y[i] });
    return { points, stop: this.plan.stop[at] === 1 };
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
