"""From scenario files to the file of a suite: what to search, and how what was chosen is written."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import yaml

from litsim_sim.campaign.suite import Suite
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing
from litsim_sim.io.yaml_input import validate_yaml
from litsim_sim.mining.selection import Chosen
from litsim_sim.recordings.segments import Manifest
from litsim_sim.scenario.scenario import packaged_scenarios

MANIFEST = "manifest.yaml"


def scenario_names(given: Iterable[str]) -> list[str]:
    """Packaged names and files of scenarios, each once: as given, and for a folder of segments those of its manifest.

    Raises:
        InputError: a folder has no manifest, or it cannot be read.
    """
    names: list[str] = []
    for each in given:
        path = Path(each)
        if each not in packaged_scenarios() and path.is_dir():
            if not (path / MANIFEST).is_file():
                raise InputError(f"{path}: no {MANIFEST}: expected scenarios, or a folder that `data segments` wrote")
            names += [str(path / f"{segment.name}.yaml") for segment in Manifest.read(path / MANIFEST).segments]
        else:
            names.append(each)
    return list(dict.fromkeys(names))


def suite_fields(chosen: Sequence[Chosen], folder: Path, **fields: Any) -> dict[str, Any]:
    """The fields of a suite file in `folder` with the chosen cases; `fields` are those beside `cases`."""
    cases = [
        {
            "scenario": _seen_from(each.scenario, folder),
            "ego_id": each.ego,
            "tags": [str(kind) for kind in each.kinds],
            "events": [event.entry() for event in each.events],
        }
        for each in chosen
    ]
    return fields | {"cases": cases}


def write_suite(path: Path, values: dict[str, Any]) -> Suite:
    """Write the file of a suite, and return the suite.

    Raises:
        InputError: there is no case in it, or it cannot be written.
    """
    if not values["cases"]:
        raise InputError("no scenario holds any of the events that were asked for: there is nothing to write")
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=10**6)
    suite = validate_yaml(values, Suite, str(path), text)
    with replacing(path) as new:
        new.write_text(text, encoding="utf-8")
    return suite


def _seen_from(scenario: str, folder: Path) -> str:
    if scenario in packaged_scenarios():
        return scenario
    return Path(os.path.relpath(Path(scenario).resolve(), folder.resolve())).as_posix()
