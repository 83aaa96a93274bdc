"""What the scenarios of a training consist of, so that a training is not resumed with others."""

from __future__ import annotations

import json
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from litsim_research.policies.data import TrainingData
from litsim_research.predictors.data.sources import digest_of
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import Scenario

FILES = ("recording", "net")
SHOWN = 60  # most characters of a field's value in an error


@dataclass(frozen=True)
class DataState:
    """The scenarios of a training, each once, in the order of the configuration, as they are when it begins.

    Attributes:
        scenarios: the scenarios.
        described: for each its part, training or validation, its name and fields, and the SHA-256 of its recording and
            net. Paths are left out, so that files may be moved, and so is the description.
    """

    scenarios: tuple[Scenario, ...] = ()
    described: tuple[dict[str, Any], ...] = ()

    @classmethod
    def of(cls, data: TrainingData) -> DataState:
        """The state of `data`."""
        once = {id(each): ("training", each) for each in data.train}
        once |= {id(each): ("validation", each) for each in data.validation}
        scenarios = tuple(each for _, each in once.values())
        return cls(scenarios, tuple(_described(part, each) for part, each in once.values()))

    def to_json(self) -> str:
        """The description, for a checkpoint."""
        return json.dumps(self.described)

    def refuse_other(self, then: str, where: Path) -> None:
        """Check that a training, begun with the state `then` of :meth:`to_json`, would go on with the same scenarios.

        Raises:
            InputError: a file or field of a scenario has changed, or there are other scenarios.
        """
        before, now = json.loads(then), json.loads(self.to_json())
        expected, actual = ([f"{each['name']} ({each['part']})" for each in state] for state in (before, now))
        if expected != actual:
            added = ", ".join(name for name in actual if name not in expected) or "none"
            missing = ", ".join(name for name in expected if name not in actual) or "none"
            raise _other(where, f"set of scenarios: {added} added, {missing} missing")
        for scenario, old, new in zip(self.scenarios, before, now, strict=True):
            for name in FILES:
                if new[name] != old[name]:
                    file = getattr(scenario.file, name)
                    digests = f"{file} has SHA-256 {new[name]}, expected {old[name]}"
                    raise _other(where, f"{name} of scenario {scenario.name}: {digests}")
            for name, value in new["fields"].items():
                if value != old["fields"].get(name):
                    values = f"{_shown(value)}, expected {_shown(old['fields'].get(name))}"
                    raise _other(where, f"scenario {scenario.name}: its field {name} is {values}")


def _described(part: str, scenario: Scenario) -> dict[str, Any]:
    fields = scenario.file.model_dump(mode="json", exclude={*FILES, "description"})
    digests = {name: digest_of(Path(getattr(scenario.file, name))) for name in FILES}
    return {"part": part, "name": scenario.name, "fields": fields, **digests}


def _other(where: Path, what: str) -> InputError:
    return InputError(f"{where}: trained on another {what}; restore it, or train into another folder")


def _shown(value: Any) -> str:
    return textwrap.shorten(json.dumps(value), SHOWN, placeholder=" …")
