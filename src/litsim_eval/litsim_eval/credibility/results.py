"""Results of encounters driven by several setups, as values for JSON and as a table of every run."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from litsim_data.encounters.encounter import Encounter
from litsim_eval.campaign.bootstrap import LEVEL, RESAMPLES, SEED
from litsim_eval.campaign.case import code_versions
from litsim_eval.campaign.criteria import CriterionResult, Limits
from litsim_eval.credibility.measures import QUANTITIES, mean_distance, measured
from litsim_eval.credibility.responses import Responses
from litsim_eval.credibility.running import Drive, DriveOrReason, RunKey, Setup, Task
from litsim_sim.io.files import replacing
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.scenario import packaged

BARS_FILE = "bars.yaml"
JSON_FILE, CSV_FILE = "credibility.json", "credibility.csv"
PEOPLE = "people"
DIGITS = 4  # decimals in the table


@dataclass(frozen=True)
class Failure:
    """A run without a result, and the reason in one line."""

    setup: str
    encounter: str
    reason: str


@dataclass(frozen=True)
class Results:
    """Encounters and how setups drove in them.

    Attributes:
        encounters: all that were driven.
        setups: what drove.
        drivers: number of drivers in each encounter.
        responses: of each setup, by name, in the encounters in which no run failed; none if there is no such encounter.
        failures: runs without a result.
    """

    encounters: tuple[Encounter, ...]
    setups: tuple[Setup, ...]
    drivers: int
    responses: Mapping[str, Responses]
    failures: tuple[Failure, ...]

    @classmethod
    def of(cls, task: Task, outcomes: Iterable[tuple[RunKey, DriveOrReason]]) -> Results:
        """Returns the results of `task`, of which all `outcomes` are given, in any order."""
        of_run, responses, failures = dict(outcomes), {}, []
        for number, setup in enumerate(task.setups):
            rows, drives = [], []
            for position, encounter in enumerate(task.encounters):
                own = [of_run[RunKey(number, position, driver)] for driver in range(task.drivers)]
                failures += [Failure(setup.name, encounter.name, why) for why in own if isinstance(why, str)]
                driven = [drive for drive in own if not isinstance(drive, str)]
                if len(driven) == task.drivers:
                    rows.append(encounter)
                    drives.append(driven)
            if rows:
                responses[setup.name] = Responses.of(rows, drives)
        return cls(tuple(task.encounters), tuple(task.setups), task.drivers, responses, tuple(failures))

    @cached_property
    def people(self) -> Responses:
        """What people did, as if a setup had driven exactly so."""
        return Responses.of(
            self.encounters, [[Drive(encounter.truth, None, contact=False)] for encounter in self.encounters]
        )

    @property
    def drives(self) -> dict[str, Responses]:
        """Responses of people, then of all setups, by name."""
        return {PEOPLE: self.people, **self.responses}

    @cached_property
    def versions(self) -> dict[str, str]:
        """Versions of LitSim and of what it is built on."""
        return code_versions()

    @cached_property
    def measures(self) -> dict[str, dict[str, Any]]:
        """Measures by setup; see :func:`litsim_eval.credibility.measures.measured`."""
        return {name: measured(own) for name, own in self.responses.items()}

    def to_json(self) -> dict[str, Any]:
        """Returns the results as values for JSON."""
        errors = Counter(failure.setup for failure in self.failures)
        return {
            "encounters": len(self.encounters),
            "kinds": dict(Counter(encounter.note.kind for encounter in self.encounters)),
            "sites": dict(Counter(encounter.note.site for encounter in self.encounters)),
            "splits": dict(Counter(encounter.note.split for encounter in self.encounters)),
            "drivers": self.drivers,
            "policies": {
                setup.name: self.measures[setup.name]
                | {"bars": [asdict(result) for result in judged(self.measures[setup.name])]}
                | {"policy": setup.policy, "parameters": setup.parameters, "errors": errors[setup.name]}
                for setup in self.setups
                if setup.name in self.measures
            },
            "bootstrap": {"level": LEVEL, "resamples": RESAMPLES, "seed": SEED, "over": "vehicles that react"},
            "versions": self.versions,
        }


def write_csv(results: Results, path: Path) -> None:
    """Writes a line for each run, and for people in each encounter; raises InputError if that is impossible."""
    write_rows((row for name, own in results.drives.items() for row in _rows(name, own)), path)


def write_rows(rows: Iterable[Mapping[str, object]], path: Path) -> None:
    """Writes `rows`, one at least, all with the same fields, as CSV; raises InputError if that is impossible."""
    first, *others = rows
    with replacing(path) as new, new.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(first), lineterminator="\n")
        writer.writeheader()
        writer.writerows([first, *others])


def _rows(name: str, responses: Responses) -> Iterator[dict[str, object]]:
    """Yields a line for each run of the setup `name`; what is not known is empty."""
    error = {"position_error_m": responses.along, "across_error_m": responses.across}
    for n, encounter in enumerate(responses.encounters):
        about = {field: getattr(encounter.note, field) for field in ("kind", "site", "split", "agent", "opponent")}
        for k in range(responses.drivers):
            own = {"taken_over_s": responses.taken_over_s[n, k], "contact": float(responses.touched[n, k])}
            own |= {field: mean_distance(values[n : n + 1, k : k + 1])[0] for field, values in error.items()}
            own |= {f"{q}_{unit}": getattr(responses.simulated, q)[n, k] for q, (unit, _) in QUANTITIES.items()}
            figures = {field: round(float(value), DIGITS) if np.isfinite(value) else "" for field, value in own.items()}
            yield {"encounter": encounter.name, **about, "driven_by": name, "driver": k, **figures}


class Bars(BaseModel):
    """Limits on the measures of a policy."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    bars: Annotated[list[Limits], Field(min_length=1)]


def bars_path() -> Path:
    """Returns the packaged file of the bars."""
    return packaged(f"credibility/{BARS_FILE}", "litsim_eval")


@cache
def bars() -> tuple[Limits, ...]:
    """Returns the packaged bars."""
    return tuple(read_yaml(bars_path(), Bars).bars)


def judged(figures: Mapping[str, Any]) -> list[CriterionResult]:
    """Returns the verdict of each bar on the measures of a policy, as in `credibility.json`.

    Bars on drawn drivers are left out where none were drawn.
    """
    return [bar.judge(figures.get(bar.field)) for bar in bars() if bar.field in figures]
