import numpy as np
import pytest

from litsim_policy.ego.batched import BatchedEgos
from litsim_policy.ego.track import TrackEgo
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import smooth_step
from litsim_sim.core.scene import Controller
from litsim_sim.scenario.batched import BatchedScenario
from made_encounters import HISTORY, OPPONENT, STEPS, encounter_note, encounter_scenario


def from_track(run, note) -> np.ndarray:
    """Distances [m] of the ego from its track at all steps."""
    track = note["truth"]["opponent"]
    return np.hypot(run.series(OPPONENT, "x") - track["x"], run.series(OPPONENT, "y") - track["y"])


def path_note(x: np.ndarray, y: np.ndarray) -> dict:
    """The note of an encounter in which the opponent moves through `x`, `y` (T,) [m]."""
    note, vx, vy = encounter_note(), np.gradient(x, 0.1), np.gradient(y, 0.1)
    track = {"x": x, "y": y, "yaw": np.unwrap(np.arctan2(vy, vx)), "speed": np.hypot(vx, vy)}
    note["truth"]["opponent"] = {name: values.tolist() for name, values in track.items()}
    return note


def test_a_braking_track_is_driven_within_centimetres_and_off_the_log(drive) -> None:
    note = encounter_note()
    run = drive(encounter_scenario(note), "track")
    assert from_track(run, note).max() < 0.02
    assert run.series(OPPONENT, "controller")[HISTORY] == Controller.EGO
    assert run.from_log(OPPONENT, STEPS - 1) > 10.0


def test_a_lane_change_is_driven_within_centimetres(drive) -> None:
    note, since = encounter_note(), np.clip((np.arange(STEPS) - HISTORY) / 30, 0.0, 1.0)
    y = np.array(note["truth"]["opponent"]["y"]) + 3.66 * smooth_step(since)
    note = path_note(np.array(note["truth"]["opponent"]["x"]), y)
    run = drive(encounter_scenario(note), "track", policy="replay")
    assert from_track(run, note).max() < 0.03
    assert np.abs(run.series(OPPONENT, "yaw") - note["truth"]["opponent"]["yaw"]).max() < 0.05


def test_a_turn_at_a_junction_is_driven_within_centimetres(drive) -> None:
    """A circle of 12 m at 6 m/s, that begins at the end of the history."""
    angle = 0.05 * np.clip(np.arange(STEPS) - HISTORY, 0, 31)
    before = 0.6 * np.minimum(np.arange(STEPS) - HISTORY, 0.0)
    after = 0.6 * np.maximum(np.arange(STEPS) - HISTORY - 31, 0.0)
    x = 100.0 + before + 12.0 * np.sin(angle) + after * np.cos(angle)
    y = -5.49 + 12.0 * (1.0 - np.cos(angle)) + after * np.sin(angle)
    note = path_note(x, y)
    run = drive(encounter_scenario(note, x=x[0], speed=6.0), "track", policy="replay")
    assert from_track(run, note).max() < 0.03


def test_jitter_of_the_record_is_not_driven(drive) -> None:
    note = encounter_note()
    jitter = np.random.default_rng(0).normal(scale=0.05, size=STEPS)
    note["truth"]["opponent"]["x"] = (np.array(note["truth"]["opponent"]["x"]) + jitter).tolist()
    run = drive(encounter_scenario(note), "track")
    assert from_track(run, note).max() < 0.25
    assert np.abs(np.diff(run.series(OPPONENT, "speed"))).max() < 0.5


def test_in_a_batch_it_answers_as_alone() -> None:
    scenes = [encounter_scenario(encounter_note()) for _ in range(2)]
    batch, alone = BatchedScenario.of(scenes), [TrackEgo(scene) for scene in scenes]
    together = BatchedEgos(batch, [TrackEgo(scene) for scene in scenes])
    for step in (0, HISTORY, HISTORY + 10):
        expected = [ego.plan(scene.log.table(step)) for ego, scene in zip(alone, scenes, strict=True)]
        assert together.plan(batch.log.table(step), range(2)) == expected
    assert expected[0].acceleration < -1.0


def test_a_scenario_without_a_track_is_refused() -> None:
    with pytest.raises(InputError, match=r"made.parquet: header: notes.encounter is missing"):
        TrackEgo(encounter_scenario(None))
