"""Drivers whose place in a ranking is plain, as functions from an encounter to the agent's track; and encounters."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from litsim_data.encounters.encounter import Encounter
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.scenario.encounter_note import Track
from made_encounters import GAP, HISTORY, LANE_Y, LENGTH, SPEED, STEPS, encounter_note, encounter_scenario

LATE_STEPS = 10  # 1 s
SUPERHUMAN = 8.0  # [m/s2]


def made_encounters(count: int) -> list[Encounter]:
    """Encounters that differ in how much the opponent brakes, and in when and how hard the agent does."""
    one = Encounter.of_scenario(encounter_scenario(encounter_note()))
    rng = np.random.default_rng(0)
    encounters = []
    for number in range(count):
        lost, begin, duration = rng.uniform(3.0, 5.0), HISTORY + int(rng.integers(5, 13)), int(rng.integers(15, 20))
        opponent = straight(50.0 + GAP + LENGTH, braking(HISTORY, lost, 15))
        agent = straight(50.0, braking(begin, lost, duration))
        note = one.note.model_copy(update={"site": f"site_{number}"})
        encounters.append(replace(one, note=note, truth=agent, opponent_truth=opponent))
    return encounters


def copy(encounter: Encounter) -> Track:
    """Does as people did."""
    return encounter.truth


def late(encounter: Encounter) -> Track:
    """Does as people did, a second later."""
    speed, begin = encounter.truth.speed, encounter.note.onset_step
    return onward(encounter, np.concatenate([np.full(LATE_STEPS, speed[begin]), speed[begin:-LATE_STEPS]]))


def never(encounter: Encounter) -> Track:
    """Never yields."""
    return onward(encounter, np.full(len(encounter.truth) - encounter.note.onset_step, encounter.truth.speed[0]))


def superhuman(encounter: Encounter) -> Track:
    """Brakes at once, at 8 m/s2."""
    since = STEP_S * np.arange(len(encounter.truth) - encounter.note.onset_step)
    return onward(encounter, np.maximum(encounter.truth.speed[encounter.note.onset_step] - SUPERHUMAN * since, 0.0))


PLANTED = {driver.__name__: driver for driver in (copy, late, never, superhuman)}


def onward(encounter: Encounter, speed: FloatArray) -> Track:
    """The record up to the onset, from there on straight on at these speeds."""
    truth = encounter.truth
    return straight(truth.x[0], np.concatenate([truth.speed[: encounter.note.onset_step], speed]))


def braking(begin: int, lost: float, duration: int) -> FloatArray:
    """Speeds of a vehicle that loses this much evenly from step `begin` on, within `duration` steps."""
    return SPEED - lost / duration * np.clip(np.arange(STEPS) - begin, 0, duration)


def straight(x: float, speed: FloatArray) -> Track:
    """A track along a lane from `x` on."""
    way = np.concatenate([[0.0], np.cumsum(0.5 * STEP_S * (speed[1:] + speed[:-1]))])
    return Track(x + way, np.full(len(speed), LANE_Y), np.zeros(len(speed)), speed)


def encounter_files(folder: Path, note: dict[str, Any] | None, names: Sequence[str] = ("made",)) -> Path:
    """The made encounter in files of a folder, once by each name, with a `note` in its header unless that is None."""
    scenario = encounter_scenario(note)
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        scenario.recording.write(folder / f"{name}.parquet")
        fields = scenario.file.model_copy(update={"name": name, "recording": f"{name}.parquet"})
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(fields.model_dump(mode="json")))
    return folder
