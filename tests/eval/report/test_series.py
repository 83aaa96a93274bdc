"""Tracks and plots of runs whose answers are known."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from litsim_eval.report.content import TTC_MAX, counts, deviations, speeds, times_to_leader
from litsim_eval.report.tracks import collect, ghosts_of, tracks_of
from litsim_sim.core.colours import Mode
from litsim_sim.core.scene import Controller
from litsim_sim.record.run import Run

Make = Callable[..., Any]


def test_modes_tell_hand_back_from_takeover(small_run: Run) -> None:
    tracks = tracks_of(small_run)
    assert (tracks.frames, len(tracks.id)) == (61, 150)
    assert tracks.mode[0].tolist() == [Mode.EGO] * 61
    held = np.flatnonzero(tracks.mode[1] == Mode.POLICY)
    back = np.flatnonzero(tracks.mode[1] == Mode.HANDBACK)
    assert (held[0], held[-1], back[0], back[-1]) == (20, 35, 36, 45)
    assert counts(tracks, Mode.POLICY)[[19, 20, 36]].tolist() == [0.0, 1.0, 0.0]
    assert ghosts_of(small_run).id.tolist() == [1, 2]


def test_absent_agents_keep_their_nearest_state(agent_table: Make) -> None:
    late = [agent_table(k, *([{"id": 5, "x": 10.0 + k}] if 2 <= k <= 3 else [])) for k in range(6)]
    tracks = collect(late, 0, 5)
    assert tracks.present[0].tolist() == [False, False, True, True, False, False]
    assert tracks.x[0].tolist() == [12.0, 12.0, 12.0, 13.0, 13.0, 13.0]
    assert np.isnan(speeds(tracks, 5)[[0, 4]]).all()
    assert np.isnan(speeds(tracks, 99)).all()


def test_states_that_are_not_finite_count_as_absent(agent_table: Make) -> None:
    tracks = collect([agent_table(0, {"id": 1, "x": np.nan}, {"id": 2})], 0, 0)
    assert tracks.present[:, 0].tolist() == [False, True]
    assert np.isfinite(tracks.x).all()


def test_a_missing_step_leaves_its_frame_empty(agent_table: Make) -> None:
    tracks = collect([agent_table(k, {"id": 1}) for k in (3, 5)], 3, 5)
    assert tracks.present[0].tolist() == [True, False, True]


def test_deviation_is_the_distance_from_the_log(small_run: Run) -> None:
    found = deviations(tracks_of(small_run), ghosts_of(small_run))
    assert found[1, 40] == pytest.approx(0.3 * 2.0)
    assert np.isnan(found[1, [10, 50]]).all()  # exactly on its log
    assert found[0, 60] == pytest.approx(0.5 * 5.0**2)


def test_time_to_collision(small_run: Run, agent_table: Make) -> None:
    ego = {"id": 1, "x": 0.0, "speed": 12.0, "controller": Controller.EGO}
    cases = [
        ([{"id": 2, "x": 24.5, "speed": 8.0}], 5.0),  # a gap of 20 m closes at 4 m/s
        ([{"id": 2, "x": 24.5, "speed": 8.0}, {"id": 3, "x": 10.0, "y": 3.5, "speed": 0.0}], 5.0),  # beside, not ahead
        ([{"id": 2, "x": -10.0, "speed": 20.0}], np.nan),  # behind
        ([{"id": 2, "x": 24.5, "speed": 13.0}], np.nan),  # drives away
        ([{"id": 2, "x": 70.0, "speed": 11.0}], np.nan),  # farther than TTC_MAX
        ([{"id": 2, "x": 24.5, "speed": 8.0, "yaw": np.pi}], 1.0),  # comes towards the ego
        ([], np.nan),
    ]
    tables = [agent_table(k, ego, *others) for k, (others, _) in enumerate(cases)]
    found, others = times_to_leader(replace(small_run, tables=tables), 0, len(cases))
    assert found == pytest.approx([expected for _, expected in cases], nan_ok=True)
    assert np.isnan(others).all()
    assert TTC_MAX < 59.0
