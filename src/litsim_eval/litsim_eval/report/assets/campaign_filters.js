// The controls of the filters, what they say, and the list of measures to show.

class FilterBar {
  // campaign: takes setFilter(changes), setRange(path, [low, high]), clear() and choose(path, wanted).
  constructor(runs, campaign) {
    Object.assign(this, { runs, campaign });
    this.#choices();
    this.#range();
    this.#measures();
    $$("text").addEventListener("input", () => campaign.setFilter({ text: $$("text").value }));
    $$("clear").addEventListener("click", () => campaign.clear());
  }

  #choices() {
    const { runs } = this;
    const names = [...new Set(runs.criteria.map(({ name }) => name))];
    const options = { verdict: [NOT_PASSED, ...WORST_FIRST], variant: runs.variants, tag: runs.tags, criterion: names };
    for (const name of CHOICES) {
      for (const each of options[name]) make("option", "", $$(name), each).value = each;
      $$(name).closest("label").hidden = options[name].length < 2 && name !== "criterion";
      $$(name).addEventListener("change", () => this.campaign.setFilter({ [name]: $$(name).value }));
    }
  }

  #range() {
    for (const { path, label } of this.runs.fields) make("option", "", $$("measure"), label).value = path;
    $$("measure").closest("fieldset").hidden = !this.runs.fields.length;
    $$("measure").addEventListener("change", () => this.#bounds());
    const bound = (id, otherwise) => ($$(id).value === "" ? otherwise : Number($$(id).value));
    for (const id of ["low", "high"]) {
      $$(id).addEventListener("change", () => this.campaign.setRange($$("measure").value, [bound("low", -Infinity), bound("high", Infinity)]));
    }
  }

  #measures() {
    $$("columns").hidden = !this.runs.fields.length;
    for (const { path, label } of this.runs.fields) {
      const box = make("input", "", make("label", "", $$("measures")));
      Object.assign(box, { type: "checkbox", value: path });
      box.after(label);
      box.parentElement.title = path;
      box.addEventListener("change", () => this.campaign.choose(path, box.checked));
    }
  }

  tick(measures) {
    for (const box of $$("measures").querySelectorAll("input")) box.checked = measures.includes(box.value);
  }

  // Say what the filters are, and what they have left.
  show(filter, selected) {
    this.filter = filter;
    for (const name of [...CHOICES, "text"]) if ($$(name).value !== filter[name]) $$(name).value = filter[name];
    this.#bounds();
    const counts = WORST_FIRST.map((verdict) => [selected.filter((run) => run.verdict === verdict).length, verdict]);
    const told = counts.filter(([count]) => count).map(([count, verdict]) => `${count} ${verdict}`);
    $$("shown").textContent = `${selected.length} of ${this.runs.runs.length} runs${told.length ? `: ${told.join(", ")}` : ""}`;
    const chips = this.#chips();
    $$("chips").replaceChildren(...chips);
    $$("clear").hidden = !chips.length;
  }

  #bounds() {
    const range = this.filter.ranges.get($$("measure").value) || [-Infinity, Infinity];
    ["low", "high"].forEach((id, end) => ($$(id).value = Number.isFinite(range[end]) ? +range[end].toPrecision(6) : ""));
  }

  // A button for each filter, which drops it.
  #chips() {
    const { campaign, filter, runs } = this;
    const found = ["text", ...CHOICES]
      .filter((name) => filter[name])
      .map((name) => [`${name}: ${filter[name]}`, () => campaign.setFilter({ [name]: "" })]);
    for (const [path, range] of filter.ranges) {
      const label = runs.fieldOf.get(path)?.label ?? path;
      found.push([`${label}: ${between(range)}`, () => campaign.setRange(path, [-Infinity, Infinity])]);
    }
    return found.map(([text, drop]) => {
      const chip = make("button", "chip", null, `${text} ✕`);
      Object.assign(chip, { type: "button", title: "drop this filter" });
      chip.addEventListener("click", drop);
      return chip;
    });
  }
}

function between([low, high]) {
  if (low === -Infinity) return `≤ ${read(high, null)}`;
  return high === Infinity ? `≥ ${read(low, null)}` : `${read(low, null)} … ${read(high, null)}`;
}
