"""Files of a mined suite: the scenarios to search, and the suite to write."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import yaml

from litsim_data.mining.selection import Chosen
from litsim_data.segments import MANIFEST_FILE, Manifest
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import relative, replacing, write_text
from litsim_sim.scenario.scenario import Scenario, packaged, packaged_nets, packaged_scenarios


def scenario_names(scenarios: Iterable[str]) -> list[str]:
    """Returns unique names and files of scenarios, with folders of segments replaced by the scenarios of their
    manifests.

    Raises:
        InputError: a folder has no manifest, or it cannot be read.
    """
    names: list[str] = []
    for name in scenarios:
        path = Path(name)
        if name not in packaged_scenarios() and path.is_dir():
            if not (path / MANIFEST_FILE).is_file():
                raise InputError(
                    f"{path}: no {MANIFEST_FILE}: expected scenarios, or a folder that `data segments` wrote"
                )
            names += [str(path / f"{segment.name}.yaml") for segment in Manifest.read(path / MANIFEST_FILE).segments]
        else:
            names.append(name)
    return list(dict.fromkeys(names))


def write_suite(path: Path, chosen: Sequence[Chosen], name: str, egos: Sequence[str]) -> None:
    """Writes the suite `name` of the chosen cases, with `egos`, to a file.

    Raises:
        InputError: there are no cases, or the file cannot be written.
    """
    if not chosen:
        raise InputError("no scenario holds any of the events that were asked for: there is nothing to write")
    cases = [
        {
            "scenario": _seen_from(case.scenario, path.parent),
            "ego_id": case.ego,
            "tags": [str(kind) for kind in case.kinds],
            "events": [event.entry() for event in case.events],
        }
        for case in chosen
    ]
    suite = {"name": name, "egos": list(egos), "cases": cases}
    write_text(path, yaml.safe_dump(suite, sort_keys=False, default_flow_style=None, width=10**6))


def pack(chosen: Sequence[Chosen], folder: Path) -> list[Chosen]:
    """Copies the scenarios of `chosen` to `folder`, each with its part of the recording; returns cases of the copies.

    The folder is self-contained, except for packaged nets and packaged scenarios, which are not copied.

    Raises:
        InputError: a scenario cannot be used, two have one name, or a file cannot be written.
    """
    names = [name for name in dict.fromkeys(case.scenario for case in chosen) if name not in packaged_scenarios()]
    moved: dict[str, str] = {}
    for name in names:
        scenario = Scenario.load(name)
        path = folder / f"{scenario.name}.yaml"
        if str(path) in moved.values():
            raise InputError(f"{name}: a second scenario with the name {scenario.name}: rename one to pack both")
        write_scenario(scenario, path)
        moved[name] = str(path)
    return [replace(case, scenario=moved.get(case.scenario, case.scenario)) for case in chosen]


def write_scenario(scenario: Scenario, path: Path) -> None:
    """Writes a scenario to the file `path`, and beside it its part of the recording, and its net unless packaged.

    Raises:
        InputError: a file cannot be written.
    """
    recording, net = path.with_suffix(".parquet"), scenario.net_path
    scenario.recording.write(recording)
    net_name = net.name.removesuffix(".net.xml")
    if net_name not in packaged_nets() or net != packaged(f"nets/{net.name}").resolve():
        net_name = net.name
        with replacing(path.parent / net_name) as new:
            shutil.copyfile(net, new)
    values = scenario.file.model_dump(mode="json", exclude_defaults=True, exclude={"crop"})
    values |= {"recording": recording.name, "net": net_name}
    write_text(path, yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=120))


def _seen_from(scenario: str, folder: Path) -> str:
    return scenario if scenario in packaged_scenarios() else relative(Path(scenario), folder)
