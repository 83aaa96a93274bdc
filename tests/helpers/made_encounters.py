"""Encounters made by hand: a leader brakes, and its follower does so 1 s later. Scenarios are on the net us101_like."""

from typing import Any

import numpy as np

from litsim_data.encounters.following import FollowingTrack
from litsim_sim.core.scene import STEP_S
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import Scenario, Sources, packaged
from litsim_sim.scenario.scenario_file import ScenarioFile

OPPONENT, AGENT = 1, 2
HISTORY, STEPS = 40, 101  # steps
SPEED, GAP, LENGTH, LANE_Y = 12.0, 10.0, 4.5, -5.49
NET = packaged("nets/us101_like.net.xml")


def braking(begin: int, steps: int = STEPS) -> dict[str, Any]:
    """Way [m] and speed [m/s] of a vehicle that loses 4 m/s within 2 s from step `begin` on."""
    speed = SPEED - 0.2 * np.clip(np.arange(steps) - begin, 0, 20)
    return {"x": np.concatenate([[0.0], np.cumsum(0.5 * STEP_S * (speed[1:] + speed[:-1]))]), "speed": speed}


def track_note(x: float, begin: int) -> dict[str, list[float]]:
    """A vehicle in one lane from `x` on that brakes from step `begin` on."""
    motion = braking(begin)
    still = [0.0] * STEPS
    return {"x": (x + motion["x"]).tolist(), "y": [LANE_Y] * STEPS, "yaw": still, "speed": motion["speed"].tolist()}


def encounter_note() -> dict[str, Any]:
    """The note of the encounter."""
    return {
        "kind": "leader_brakes",
        "site": "made",
        "agent": AGENT,
        "opponent": OPPONENT,
        "onset_step": HISTORY,
        "split": "tuning",
        "truth": {
            "agent": track_note(50.0, HISTORY + 10),
            "opponent": track_note(50.0 + GAP + LENGTH, HISTORY),
        },
    }


def encounter_scenario(note: dict[str, Any] | None, x: float = 50.0 + GAP + LENGTH, speed: float = SPEED) -> Scenario:
    """The scenario of the encounter, with a `note` in its header unless that is None: the log keeps both at pace.

    `x` and `speed` are the place of the opponent at step 0 and its speed.
    """
    at = np.arange(STEPS)
    columns: dict[str, Any] = {
        "vehicle_id": np.repeat([OPPONENT, AGENT], STEPS),
        "frame": np.tile(at, 2),
        "x": np.concatenate([x + speed * STEP_S * at, 50.0 + SPEED * STEP_S * at]),
        "y": LANE_Y,
        "yaw": 0.0,
        "speed": np.repeat([speed, SPEED], STEPS),
        "acceleration": 0.0,
        "length": LENGTH,
        "width": 1.9,
        "kind": 0,
        "lane": 2,
    }
    columns = {name: np.broadcast_to(values, (2 * STEPS,)) for name, values in columns.items()}
    header = RecordingHeader("made", licence="made", notes={} if note is None else {"encounter": note})
    recording = Recording.from_columns(header, columns, "made")
    seconds = {"history_s": HISTORY * STEP_S, "simulation_s": (STEPS - 1 - HISTORY) * STEP_S}
    file = ScenarioFile(name="made", recording="made.parquet", net=str(NET), ego=OPPONENT, **seconds)
    return Scenario(file, "made", Sources(recording, LaneMap.from_net(NET)))


def following_track(begin: int = 60, late: int = 10, steps: int = 150) -> FollowingTrack:
    """Car following of `steps` samples: the leader brakes from `begin` on, its follower `late` samples later."""
    leader, follower = (braking(sample, steps=steps) for sample in (begin, begin + late))
    return FollowingTrack(
        site="i80",
        period=1600,
        follower=AGENT,
        leader=OPPONENT,
        leader_length=LENGTH,
        first_frame=1000,
        front=follower["x"],
        speed=follower["speed"],
        leader_rear=leader["x"] + GAP,
        leader_speed=leader["speed"],
    )
