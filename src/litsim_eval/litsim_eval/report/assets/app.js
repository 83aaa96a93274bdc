// The player: time, buttons, keys, and what they move.

const $$ = (id) => document.getElementById(id);
// An element with children; strings become text, never markup, for some are from the record.
const element = (tag, ...children) => {
  const made = document.createElement(tag);
  made.append(...children);
  return made;
};
const SPEEDS = [0.25, 0.5, 1, 2, 4];
const TOGGLES = ["plan", "ghosts", "forecasts", "conflicts"];

class Player {
  constructor(scene) {
    Object.assign(this, { scene, time: 0, playing: false, speed: 1, then: 0 });
    this.drivers = ["its log", "the policy", scene.ego_by, "the way back to its log", "its own intent"];
    document.querySelector(".stage").classList.toggle("flat", scene.isFlat());
    this.view = new BirdView($$("view"), scene);
    this.charts = makeCharts($$("plots"), scene, (time) => this.seek(time));
    $$("scrub").max = scene.last;
    for (const each of document.querySelectorAll(".of-plan")) each.hidden = !scene.plan.topic;
    $$("plan").title = `What the ego's stack plans, on ${scene.plan.topic} (T)`;
    this.#legend();
    this.#buttons();
    this.#pointer();
    this.#verdict();
    this.#tables();
    document.addEventListener("keydown", (event) => this.#key(event));
    for (const query of ["(prefers-color-scheme: dark)", "print"]) {
      matchMedia(query).addEventListener("change", () => {
        this.view.readColours();
        this.show();
      });
    }
    new ResizeObserver(() => this.#resize()).observe($$("view"));
    this.#resize();
    this.view.camera.scale = Math.min(Math.max(this.view.width / 110, 4), 12);
    this.seek(scene.frameOf(scene.history));
    this.#linked();
    addEventListener("hashchange", () => this.#linked());
  }

  // To the step that the address names in seconds, as report.html#t=12.5.
  #linked() {
    const named = /[#&]t=([\d.]+)/.exec(location.hash);
    if (named) this.seek(Math.round(Number(named[1]) / this.scene.dt) - this.scene.first);
  }

  seek(time) {
    this.time = Math.min(Math.max(time, 0), this.scene.last);
    this.show();
  }

  // Whole steps from where the time is.
  step(count) {
    this.pause();
    this.seek(count > 0 ? Math.floor(this.time + 1e-6) + count : Math.ceil(this.time - 1e-6) + count);
  }

  play() {
    if (this.time >= this.scene.last) this.time = 0;
    this.playing = true;
    this.then = performance.now();
    requestAnimationFrame((now) => this.#tick(now));
    this.#playState();
  }

  pause() {
    this.playing = false;
    this.#playState();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  #playState() {
    $$("play").setAttribute("aria-label", this.playing ? "Pause" : "Play");
    document.body.classList.toggle("playing", this.playing);
  }

  #tick(now) {
    if (!this.playing) return;
    const passed = Math.max(0, now - this.then) / 1000;
    this.then = now;
    this.seek(this.time + (passed * this.speed) / this.scene.dt);
    if (this.time >= this.scene.last) this.pause();
    else requestAnimationFrame((next) => this.#tick(next));
  }

  setSpeed(speed) {
    this.speed = speed;
    $$("speed").value = String(speed);
  }

  #faster(by) {
    const at = SPEEDS.indexOf(this.speed) + by;
    this.setSpeed(SPEEDS[Math.min(Math.max(at, 0), SPEEDS.length - 1)]);
  }

  follow(on) {
    this.view.following = on;
    this.show();
  }

  turn(what, on = !this.view.shows[what]) {
    this.view.shows[what] = on;
    this.show();
  }

  select(row) {
    this.view.selected = row;
    const id = row === null ? null : this.scene.agents[row].id;
    for (const chart of this.charts) chart.select(id);
    this.show();
  }

  // To a moment of an agent, as the tables ask for.
  jump(step, id) {
    this.pause();
    const time = this.scene.frameOf(step);
    const row = this.scene.rows.get(id);
    this.time = time;
    this.select(row === undefined ? null : row);
    if (row !== undefined) this.view.reveal(row, time);
    this.show();
  }

  show() {
    const { scene, time, view } = this;
    view.draw(time);
    for (const chart of this.charts) chart.move(time);
    const seconds = scene.seconds(time).toFixed(1);
    $$("scrub").value = time;
    $$("scrub").setAttribute("aria-valuetext", `${seconds} seconds`);
    $$("clock").textContent = `${seconds} s`;
    $$("clock").title = `step ${scene.first + Math.floor(time)}`;
    $$("follow").setAttribute("aria-pressed", view.following);
    for (const what of TOGGLES) $$(what).setAttribute("aria-pressed", view.shows[what]);
    this.#state();
  }

  #resize() {
    this.view.resize();
    this.#events();
    this.show();
  }

  #legend() {
    const seen = new Set(this.scene.arrays.mode);
    for (const mode of [2, 1, 4, 3, 0]) {
      if (!seen.has(mode)) continue;
      const item = document.createElement("li");
      item.className = COLOURS[mode];
      item.textContent = NAMES[mode];
      $$("legend").append(item);
    }
  }

  #state() {
    const { scene, time, view } = this;
    $$("state").hidden = view.selected === null;
    if (view.selected !== null) $$("state").replaceChildren(...this.#describe(view.selected));
    $$("tip").hidden = view.hovered === null || view.hovered === view.selected || !scene.pose(view.hovered, time);
    if (!$$("tip").hidden) $$("tip").replaceChildren(...this.#describe(view.hovered));
  }

  // What is known of an agent now, as elements.
  #describe(row) {
    const { scene, time } = this;
    const agent = scene.agents[row];
    const pose = scene.pose(row, time);
    const name = agent.id === scene.ego ? `Ego ${agent.id}` : `Agent ${agent.id}`;
    if (!pose) return [element("b", name), element("p", "not on the road")];
    const mode = scene.modeAt(row, time);
    const facts = [
      ["follows", this.drivers[mode]],
      ["speed", `${pose.speed.toFixed(1)} m/s`],
      ["acceleration", `${scene.acceleration(row, time).toFixed(1)} m/s²`],
      ["at", `${(pose.x + scene.origin[0]).toFixed(1)}, ${(pose.y + scene.origin[1]).toFixed(1)} m`],
      [agent.kind, `${agent.length.toFixed(1)} × ${agent.width.toFixed(1)} m`],
    ];
    const ghost = mode === 0 ? null : scene.ghost(agent.id, time);
    if (ghost) facts.push(["from its log", `${Math.hypot(pose.x - ghost.x, pose.y - ghost.y).toFixed(2)} m`]);
    const record = scene.takeoverOf(agent.id, time);
    if (record) {
      const opponent = record.opponent === scene.ego ? `the ego` : `agent ${record.opponent}`;
      facts.push(["taken over at", `${(record.detected * scene.dt).toFixed(1)} s`]);
      facts.push([record.reason.replace("_", " "), `with ${opponent}`]);
      if (record.probability) facts.push(["predicted", `in ${record.ttc.toFixed(1)} s, p = ${record.probability.toFixed(2)}`]);
    }
    const rows = facts.map(([key, value]) => element("div", element("dt", key), element("dd", value)));
    return [element("b", name), element("dl", ...rows)];
  }

  // Takeovers and contacts above the time slider.
  #events() {
    const strip = $$("events");
    const width = strip.clientWidth;
    strip.replaceChildren();
    strip.setAttribute("viewBox", `0 0 ${width} 14`);
    const x = (frame) => (frame / Math.max(this.scene.last, 1)) * width;
    this.scene.takeovers.forEach((records, k) => {
      if (!records.length) return;
      const states = records.map(({ state }) => state);
      const of = states.includes("held") ? "policy" : states.includes("own_intent") ? "own" : "handback";
      svg("rect", { x: x(k), y: 6, width: x(1) + 0.5, height: 4, class: of }, strip);
    });
    for (const { step, in_log: logged } of this.scene.contacts) {
      if (!logged) svg("rect", { x: x(this.scene.frameOf(step)) - 1, y: 0, width: 2.5, height: 14, class: "conflict" }, strip);
    }
    for (const { name, field, passed } of this.judged ? this.judged.criteria : []) {
      for (const [begin, end] of (!passed && this.scene.moments[field]) || []) {
        const [from, to] = [begin, end].map((step) => x(this.scene.frameOf(step)));
        const mark = svg("rect", { x: from - 1.5, y: -2, width: to - from + 3, height: 5, rx: 1.5, class: "missed" }, strip);
        svg("title", {}, mark).textContent = name;
      }
    }
    for (const row of document.querySelectorAll("#ledger tr[data-step]")) {
      const at = x(this.scene.frameOf(Number(row.dataset.step)));
      svg("path", { d: `M${at - 4},8h8l-4,6z`, class: "policy" }, strip);
    }
  }

  #buttons() {
    const click = (id, action) =>
      $$(id).addEventListener("click", (event) => {
        action();
        if (event.detail) $$(id).blur(); // by pointer: the space bar stays with the player
      });
    click("play", () => this.toggle());
    click("back", () => this.step(-1));
    click("forward", () => this.step(1));
    click("follow", () => this.follow(!this.view.following));
    click("zoom-in", () => this.zoom(1.4));
    click("zoom-out", () => this.zoom(1 / 1.4));
    click("help", () => $$("keys").showModal());
    for (const what of TOGGLES) click(what, () => this.turn(what));
    $$("speed").addEventListener("change", (event) => {
      this.setSpeed(Number(event.target.value));
      event.target.blur();
    });
    $$("scrub").addEventListener("input", (event) => this.seek(Number(event.target.value)));
  }

  zoom(factor, at) {
    this.view.zoom(factor, at);
    this.show();
  }

  // What a campaign or the launcher has judged, if one has: badge, reasons, and a row for each criterion.
  #verdict() {
    const said = $$("verdict").textContent.trim();
    this.judged = said ? JSON.parse(said) : null;
    if (!this.judged) return;
    const { verdict, reason, criteria, campaign, rerun } = this.judged;
    for (const badge of document.querySelectorAll("#badges .good")) badge.remove();
    const badge = element("span", verdict);
    badge.className = `badge ${verdict === "passed" ? "good" : "bad"}`;
    $$("badges").prepend(badge);
    const missed = criteria.filter(({ passed }) => !passed);
    const told = document.querySelector(".problem")?.textContent ?? ""; // why the run is not valid
    for (const text of missed.length ? missed.map((each) => each.reason) : [reason]) {
      if (!text || told.includes(text)) continue;
      const line = element("p", text);
      line.className = "problem";
      $$("judged").append(line);
    }
    const links = element("p");
    links.className = "hint";
    if (campaign) {
      const back = element("a", "back to the campaign");
      back.href = campaign;
      links.append(back);
    }
    if (rerun) links.append(campaign ? " · run it again: " : "run it again: ", element("code", rerun));
    if (campaign || rerun) $$("judged").append(links);
    $$("judged").hidden = false;
    for (const { name, field, value, limit, passed, reason: why } of [...missed, ...criteria.filter((each) => each.passed)]) {
      const state = element("span", passed ? "met" : "not met");
      state.className = `badge ${passed ? "good" : "bad"}`;
      const number = value === null ? "–" : typeof value === "number" ? String(+value.toPrecision(4)) : String(value);
      const row = element("tr", element("td", name), element("td", state), element("td", number), element("td", limit), element("td", passed ? "" : why));
      row.title = field;
      const moments = passed ? [] : this.scene.moments[field] || [];
      if (moments.length) Object.assign(row.dataset, { step: moments[0][0], agent: this.scene.ego });
      $$("criteria").querySelector("tbody").append(row);
    }
    $$("criteria").hidden = !criteria.length;
  }

  #tables() {
    this.moments = [...document.querySelectorAll("tr[data-step]")];
    for (const row of this.moments) {
      row.addEventListener("click", () => {
        this.jump(Number(row.dataset.step), Number(row.dataset.agent));
        for (const each of this.moments) each.classList.toggle("current", each === row);
        const box = $$("view").getBoundingClientRect();
        if (box.top < 0 || box.top > innerHeight - 200) $$("view").scrollIntoView({ block: "center" });
      });
    }
  }

  // The next takeover after now, or the one before.
  #moment(direction) {
    const rows = [...document.querySelectorAll("#ledger tr[data-step]")];
    const frame = (row) => this.scene.frameOf(Number(row.dataset.step));
    const next = direction > 0 ? rows.find((row) => frame(row) > this.time) : rows.reverse().find((row) => frame(row) < this.time);
    if (next) next.click();
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || $$("keys").open) return;
    const onControl = event.target.closest("button, select, summary, a, dialog");
    const actions = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.step(event.shiftKey ? -Math.round(1 / this.scene.dt) : -1),
      ArrowRight: () => this.step(event.shiftKey ? Math.round(1 / this.scene.dt) : 1),
      ArrowUp: () => this.#faster(1),
      ArrowDown: () => this.#faster(-1),
      Home: () => this.seek(0),
      End: () => this.seek(this.scene.last),
      "+": () => this.zoom(1.4),
      "=": () => this.zoom(1.4),
      "-": () => this.zoom(1 / 1.4),
      f: () => this.follow(!this.view.following),
      t: () => this.turn("plan"),
      g: () => this.turn("ghosts"),
      p: () => this.turn("forecasts"),
      c: () => this.turn("conflicts"),
      n: () => this.#moment(1),
      b: () => this.#moment(-1),
      Escape: () => this.select(null),
      "?": () => $$("keys").showModal(),
    };
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (!Object.hasOwn(actions, key) || (onControl && (key === " " || event.target.tagName === "SELECT"))) return;
    // Up, down, home and end scroll the page unless the player has the focus.
    const scrolls = ["ArrowUp", "ArrowDown", "Home", "End"].includes(key);
    if (scrolls && !["view", "scrub"].includes(event.target.id)) return;
    event.preventDefault();
    actions[key]();
  }

  #pointer() {
    const canvas = $$("view");
    const held = new Map();
    const place = (event) => ({ x: event.offsetX, y: event.offsetY });
    let moved = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, place(event));
      moved = 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      const to = place(event);
      const from = held.get(event.pointerId);
      if (!from) return this.#hover(to);
      moved += Math.hypot(to.x - from.x, to.y - from.y);
      const other = [...held].find(([id]) => id !== event.pointerId)?.[1];
      if (other) this.view.zoom(Math.hypot(to.x - other.x, to.y - other.y) / Math.max(1, Math.hypot(from.x - other.x, from.y - other.y)));
      else if (moved > 4) {
        this.view.following = false;
        this.view.pan(to.x - from.x, to.y - from.y);
      }
      held.set(event.pointerId, to);
      this.show();
    });
    const release = (event) => {
      const pressed = held.delete(event.pointerId);
      if (pressed && event.type === "pointerup" && moved <= 4) this.select(this.view.agentAt(place(event), this.time));
    };
    for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, release);
    canvas.addEventListener("pointerleave", () => this.#hover(null));
    const wheel = (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 16 : 1)), place(event));
    };
    canvas.addEventListener("wheel", wheel, { passive: false });
  }

  #hover(at) {
    this.view.hovered = at && this.view.agentAt(at, this.time);
    $$("view").classList.toggle("over-agent", this.view.hovered !== null);
    if (at) Object.assign($$("tip").style, { left: `${Math.min(at.x + 14, this.view.width - 222)}px`, top: `${Math.max(8, Math.min(at.y + 14, this.view.height - 170))}px` });
    if (!this.playing) this.show();
  }
}

async function start() {
  try {
    window.litsim = new Player(new Scene(await unpack($$("data").textContent)));
    $$("loading").remove();
    document.body.classList.add("ready");
  } catch (error) {
    const old = typeof DecompressionStream === "undefined";
    $$("loading").textContent = old ? "This browser is too old for the player (it has no DecompressionStream)." : `The run cannot be shown: ${error}`;
    if (!old) throw error;
  }
}

start();
