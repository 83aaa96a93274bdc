"""Roads of the paper's experiments: real motorway, real streets, generated motorway, generated streets; in five draws.

The paper averages five runs, each with randomly chosen egos. Here a draw of a real window is a random fifth of its
egos, and a draw of generated traffic has its own traffic. Everything random is seeded by
:data:`litsim_data.traffic.seeds.PAPER`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from litsim_data.segments import MANIFEST_FILE
from litsim_data.traffic.seeds import PAPER
from litsim_data.traffic.segment_set import write_segment_set
from litsim_eval.campaign.suite import CaseEntry
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import write_text
from litsim_sim.scenario.scenario import DATA_VARIABLE, Scenario, packaged

REAL, STREETS, HIGHWAY, URBAN = "real", "streets", "highway", "urban"
SETS = (REAL, STREETS, HIGHWAY, URBAN)
RECORDED = (REAL, STREETS)
"""Sets that need recorded data."""
WINDOW = "us101_0750"
WINDOWS = Path("examples/streets/windows.py")
"""Program of the repository that makes the windows of :data:`STREETS`."""
EGOS_OF_WINDOW = 4
"""Vehicles of each window of :data:`STREETS` that are the ego."""
NETS = {HIGHWAY: "us101_like", URBAN: "urban_like"}
DRAWS = len(PAPER)
SEGMENTS = 3
"""Most segments of 28 s in a draw of generated traffic, each with one ego."""
QUICK_S = 6.0
QUICK = {HIGHWAY: "demo", URBAN: "small/street_14"}
"""Packaged scenarios of a quick trial by set, shortened to :data:`QUICK_S` [s]."""

Roads = dict[str, list[CaseEntry]]


def roads(names: Sequence[str], folder: Path, *, quick: bool = False) -> Roads:
    """Returns cases of the sets called `names`, tagged with their names; scenarios that are made go to `folder`.

    Raises:
        InputError: a recording is missing, or `folder` cannot be written.
    """
    recorded = {REAL: _real, STREETS: _streets}
    entries: Roads = {}
    for name in names:
        if name in recorded:
            entries[name] = recorded[name](folder)[: 2 if quick else None]
        else:
            entries[name] = (_quick if quick else _generated)(name, folder)
    return entries


def missing(name: str) -> str:
    """Returns what the set called `name` lacks here, to be told; empty if nothing."""
    if name in RECORDED and not os.environ.get(DATA_VARIABLE):
        return f"{DATA_VARIABLE} is not set, expected a folder of recorded data"
    if name == STREETS and not WINDOWS.is_file():
        return f"{WINDOWS} is not in this folder, expected the root of the repository"
    return ""


def _entry(name: str, scenario: str, ego: int, draw: int) -> CaseEntry:
    return CaseEntry(scenario=scenario, ego_id=ego, seed=PAPER[draw], tags=[name])


def _dealt(name: str, scenario: str, egos: Sequence[int], number: int, count: int | None = None) -> list[CaseEntry]:
    """Returns cases of `count` of the `egos` (None: all) of window `number`, dealt out to the draws at random."""
    shuffled = np.random.default_rng([PAPER[0], number]).permutation(np.array(egos)).tolist()
    return [_entry(name, scenario, ego, k % DRAWS) for k, ego in enumerate(shuffled[:count])]


def _real(_: Path) -> list[CaseEntry]:
    """Returns a case for every vehicle that can be the ego, except those on which parameters were tuned."""
    window = Scenario.load(WINDOW)
    return _dealt(REAL, WINDOW, [ego for ego in window.possible_egos if ego not in window.tuning_egos], 0)


def _streets(folder: Path) -> list[CaseEntry]:
    """Returns cases of the windows of Lankershim Boulevard and Peachtree Street on which nothing was chosen.

    Raises:
        InputError: they cannot be made.
    """
    out = folder / STREETS
    if not (out / "reported" / MANIFEST_FILE).is_file():
        made = subprocess.run([sys.executable, WINDOWS, out], capture_output=True, text=True, check=False)
        if made.returncode:
            raise InputError(f"{WINDOWS}: {(made.stderr.strip().splitlines() or ['no reason'])[-1]}")
    paths = sorted(path.resolve() for path in (out / "reported").glob("*.yaml") if path.name != MANIFEST_FILE)
    return [
        entry
        for number, path in enumerate(paths)
        for entry in _dealt(STREETS, str(path), Scenario.load(str(path)).egos, number, EGOS_OF_WINDOW)
    ]


def _generated(name: str, folder: Path) -> list[CaseEntry]:
    entries = []
    for draw, seed in enumerate(PAPER):
        files = generated(name, SEGMENTS, seed, folder)
        entries += [_entry(name, path, Scenario.load(path).ego_id, draw) for path in files]
    return entries


def generated(name: str, count: int, seed: int, folder: Path) -> list[str]:
    """Returns scenario files of `count` segments of the set called `name`; a folder in `folder` has them from then on.

    Raises:
        InputError: `folder` cannot be written.
    """
    out = folder / f"{name}_{seed}_{count}"
    if not (out / MANIFEST_FILE).is_file():
        write_segment_set(NETS[name], count, seed, out)
    return [str(path.resolve()) for path in sorted(out.glob("*.yaml")) if path.name != MANIFEST_FILE]


def _quick(name: str, folder: Path) -> list[CaseEntry]:
    path, source = folder / f"quick_{name}.yaml", QUICK[name]
    source = str(packaged(f"suites/{source}.yaml", "litsim_eval")) if "/" in source else source
    scenario = Scenario.load(source, simulation_s=QUICK_S)
    write_text(path, scenario.to_yaml())
    return [_entry(name, str(path.resolve()), ego, draw) for draw, ego in enumerate(scenario.egos[:2])]
