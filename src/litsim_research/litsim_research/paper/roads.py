"""Roads of the paper's experiments: a real window, generated motorway and generated street, in five draws each.

The paper averages five runs, each with randomly chosen egos. Here a draw of the real window is a random fifth of its
usable egos, and a draw of generated traffic has its own traffic seed. The number of the draw seeds everything random in
its runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from litsim_data.segments import MANIFEST_FILE
from litsim_data.traffic.seeds import PAPER
from litsim_data.traffic.segment_set import write_segment_set
from litsim_eval.campaign.suite import CaseEntry
from litsim_sim.io.files import replacing
from litsim_sim.scenario.scenario import Scenario, packaged

REAL, HIGHWAY, URBAN = "real", "highway", "urban"
SETS = (REAL, HIGHWAY, URBAN)
WINDOW = "us101_0750"
NETS = {HIGHWAY: "us101_like", URBAN: "urban_like"}
DRAWS = len(PAPER)
SEGMENTS = 3
"""Most segments of 28 s in a draw of generated traffic, each with one ego."""
QUICK_S = 6.0
QUICK = {HIGHWAY: "demo", URBAN: "small/street_14"}
"""Packaged scenarios of a quick trial by set, shortened to :data:`QUICK_S` [s]."""

Roads = dict[str, list[CaseEntry]]


def roads(names: Sequence[str], folder: Path, *, quick: bool = False) -> Roads:
    """Returns cases of the sets called `names`, tagged with their names; generated scenarios go to `folder`.

    Raises:
        InputError: the real window is missing, or `folder` cannot be written.
    """
    drawn = _quick if quick else _generated
    return {name: _real(quick) if name == REAL else drawn(name, folder) for name in names}


def _entry(name: str, scenario: str, ego: int, draw: int) -> CaseEntry:
    return CaseEntry(scenario=scenario, ego_id=ego, seed=draw, tags=[name])


def _real(quick: bool) -> list[CaseEntry]:
    """Returns a case for every vehicle that can be the ego, except those on which parameters were tuned."""
    window = Scenario.load(WINDOW)
    usable = np.array([ego for ego in window.possible_egos if ego not in window.tuning_egos])
    dealt = np.random.default_rng(0).permutation(usable).tolist()
    entries = [_entry(REAL, WINDOW, ego, k % DRAWS) for k, ego in enumerate(dealt)]
    return entries[:2] if quick else entries


def _generated(name: str, folder: Path) -> list[CaseEntry]:
    entries = []
    for draw, seed in enumerate(PAPER):
        files = generated(name, SEGMENTS, seed, folder / f"{name}_{draw}")
        entries += [_entry(name, path, Scenario.load(path).ego_id, draw) for path in files]
    return entries


def generated(name: str, count: int, seed: int, folder: Path) -> list[str]:
    """Returns scenario files of `count` segments of the set called `name` in `folder`, generated if missing.

    Raises:
        InputError: `folder` cannot be written.
    """
    if not (folder / MANIFEST_FILE).is_file():
        write_segment_set(NETS[name], count, seed, folder)
    return [str(path.resolve()) for path in sorted(folder.glob("*.yaml")) if path.name != MANIFEST_FILE]


def _quick(name: str, folder: Path) -> list[CaseEntry]:
    path, source = folder / f"quick_{name}.yaml", QUICK[name]
    source = str(packaged(f"suites/{source}.yaml", "litsim_eval")) if "/" in source else source
    scenario = Scenario.load(source, simulation_s=QUICK_S)
    with replacing(path) as new:
        new.write_text(scenario.to_yaml())
    return [_entry(name, str(path.resolve()), ego, draw) for draw, ego in enumerate(scenario.egos[:2])]
