// The panel of one run: a larger picture, why it was judged so, and the same case in other variants.

class Panel {
  constructor(host, campaign) {
    Object.assign(this, { host, campaign });
  }

  show(run) {
    this.host.hidden = !run;
    if (!run) return;
    const { runs } = this.campaign;
    this.host.replaceChildren();
    this.#head(run);
    this.#reasons(run);
    this.#picture(run);
    const links = make("p", "links", this.host);
    if (run.report || run.log) addLinks(links, run);
    make("code", "", links, run.folder);
    const again = make("p", "again", this.host, "run it again ");
    const command = make("code", "", again, run.rerun);
    command.addEventListener("click", () => getSelection().selectAllChildren(command));
    this.#criteria(run);
    this.#alike(run);
    this.#list("What was run", [
      ["scenario", run.scenario],
      ["ego", `agent ${run.ego_id}, driven by ${run.ego}`],
      ["background", run.policy],
      ["seed", run.seed ?? "that of the scenario"],
      ...run.parameters,
      ["tags", run.tags.map((tag) => runs.tags[tag]).join(", ") || "–"],
      ["wall time", `${read(run.wall, 1)} s`],
      ["id", run.id],
    ]);
    run.events.forEach((event) => this.#list("Event", event));
    const known = runs.fields.filter((field) => runs.value(run, field.path) !== null);
    if (known.length) {
      const all = make("details", "", this.host);
      make("summary", "", all, `all ${known.length} measures`);
      this.#pairs(all, known.map((field) => [field.path, read(runs.value(run, field.path), null)]));
    }
  }

  #head(run) {
    const head = make("header", "", this.host);
    make("span", `badge ${run.verdict}`, head, run.verdict);
    const title = make("h2", "", head);
    run.name.split("/").forEach((part, at) => title.append(...(at ? ["/", document.createElement("wbr")] : []), part));
    const buttons = make("div", "buttons", head);
    const button = (text, title, action) => {
      const made = make("button", "", buttons, text);
      Object.assign(made, { type: "button", title });
      made.setAttribute("aria-label", title);
      made.addEventListener("click", action);
    };
    button("↑", "previous run of the table (k)", () => this.campaign.step(-1));
    button("↓", "next run of the table (j)", () => this.campaign.step(1));
    button("✕", "close (escape)", () => this.campaign.close());
    make("p", "hint", this.host, this.campaign.runs.variants[run.variant]);
  }

  // A line for each criterion that is not met, or the one reason for which there is no verdict.
  #reasons(run) {
    if (!run.reason) return;
    const holder = make("div", "problem", this.host);
    const missed = run.criteria.filter(({ passed }) => !passed);
    for (const { reason } of missed) make("p", "", holder, reason);
    if (!missed.length) make("p", "", holder, run.reason);
  }

  #picture(run) {
    if (!run.picture && !run.steps) return;
    const { width, height } = PICTURE.large;
    this.campaign.painter.paint(make("canvas", "picture", this.host), run, width, height);
    const told = run.picture ? [`${(run.picture.step * run.dt).toFixed(1)} s: ${run.picture.what}`] : [];
    if (run.steps) {
      told.push(`${run.takeovers.length} takeover${run.takeovers.length === 1 ? "" : "s"}`);
      told.push(`${run.contacts.length} contact${run.contacts.length === 1 ? "" : "s"} in ${(run.steps * run.dt).toFixed(1)} s`);
    }
    make("p", "hint", this.host, told.join(" · "));
  }

  #criteria(run) {
    if (!run.criteria.length) return;
    make("h3", "", this.host, "Criteria");
    const table = make("table", "", this.host);
    for (const { criterion, value, passed, reason } of run.criteria) {
      const { name, limit, field } = this.campaign.runs.criteria[criterion];
      const row = make("tr", "", table);
      make("td", "", row, name).title = field;
      const found = make("td", passed ? "number" : "number missed", row, read(value, null));
      if (!passed) found.title = reason;
      make("td", "limit", row, limit);
      make("span", `badge ${passed ? "passed" : "failed"}`, make("td", "number", row), passed ? "met" : "not met");
    }
  }

  #alike(run) {
    const others = this.campaign.runs.alike.get(run.same).filter((each) => each !== run);
    if (!others.length) return;
    make("h3", "", this.host, "The same case in other variants");
    const table = make("table", "alike", this.host);
    for (const each of others) {
      const row = make("tr", "", table);
      make("span", `badge ${each.verdict}`, make("td", "", row), each.verdict);
      const button = make("button", "run", make("td", "", row), this.campaign.runs.variants[each.variant]);
      button.type = "button";
      button.addEventListener("click", () => this.campaign.open(each));
      addLinks(make("td", "number", row), each);
    }
  }

  #list(title, pairs) {
    make("h3", "", this.host, title);
    this.#pairs(this.host, pairs);
  }

  #pairs(host, pairs) {
    const list = make("dl", "", host);
    for (const [name, value] of pairs) {
      const pair = make("div", "", list);
      make("dt", "", pair, name);
      make("dd", "", pair, value);
    }
  }
}
