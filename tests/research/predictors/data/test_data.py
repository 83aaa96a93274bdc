"""What models are trained on: tracks, scenes, and how these are varied."""

import os
import signal
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from litsim_predictor.inference.contract import HISTORY, HORIZON, MANEUVERS
from litsim_predictor.inference.lane_frames import FRAMES, LaneFrames
from litsim_research.predictors.data.augmentation import Augmentation
from litsim_research.predictors.data.batch import SceneBatch, maneuvers_of
from litsim_research.predictors.data.scene import cut_scene
from litsim_research.predictors.data.scenes import scene_batches, training_batches
from litsim_research.predictors.data.sources import I80PairSource, Us101TrackSource, Us101WindowSource, load
from litsim_research.predictors.data.tracks import Tracks
from litsim_research.predictors.training.config import TEST_FRAMES, TRACKS, WINDOWS
from litsim_research.predictors.training.data import Locator
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.scenario import packaged

Straight = Callable[..., pd.DataFrame]
NET = packaged("nets/us101_like.net.xml")
SINE = 3
UNKNOWN_IDS = 100_000  # vehicles of the windows file whose NGSIM id is not known have greater ones
DATA_FOLDER = Path(os.environ.get("LITSIM_DATA", "."))
UNVARIED = Augmentation(mirror=0, occlude=0, no_map=0, crop=0, position_m=0, yaw_rad=0, speed_mps=0)


def only(batches: list[SceneBatch]) -> SceneBatch:
    assert len(batches) == 1
    return batches[0]


class TestManeuvers:
    @pytest.mark.parametrize(
        ("along", "left", "expected"),
        [
            (50.0, 0.0, "keep/keep"),
            (50.0, 3.6, "left/keep"),
            (50.0, -3.6, "right/keep"),
            (30.0, 0.0, "keep/brake"),
            (70.0, -3.6, "right/accelerate"),
        ],
    )
    def test_by_where_an_agent_is_after_five_seconds(self, along: float, left: float, expected: str) -> None:
        share = torch.linspace(1 / HORIZON, 1, HORIZON)[:, None]
        future = share * torch.tensor([along, left])
        known = torch.ones(HORIZON, dtype=torch.bool)
        maneuver = maneuvers_of(future[None], known[None], torch.tensor([10.0]))
        assert MANEUVERS[int(maneuver)] == expected
        known[-1] = False
        assert int(maneuvers_of(future[None], known[None], torch.tensor([10.0]))) == -1


class TestScenes:
    def test_histories_and_futures_are_those_of_the_motion(self, straight: Straight) -> None:
        tracks = Tracks.from_table("made", straight((1, 10.0, 5.0, 10.0), (2, 30.0, 9.0, 8.0), yaw=0.7), None)
        batch = next(scene_batches([tracks], stride=1))
        t = 0.2 * np.arange(1, HORIZON + 1)
        assert batch.future[0, :, :, 0].numpy() == pytest.approx(np.stack([10.0 * t, 8.0 * t]), abs=1e-3)
        assert batch.future[0, :, :, 1].abs().max() < 1e-3
        assert batch.history[0, 0, :, 0].numpy() == pytest.approx(10.0 * 0.2 * np.arange(1 - HISTORY, 1), abs=1e-3)
        assert batch.heading[0].numpy() == pytest.approx([0.7, 0.7])
        apart = (batch.position[0, 1] - batch.position[0, 0]).numpy()
        at = 0.1 * 30
        expected = np.array([20.0, 4.0]) - 2.0 * at * np.array([np.cos(0.7), np.sin(0.7)])
        assert apart == pytest.approx(expected, abs=1e-3)

    def test_targets_have_complete_histories_and_futures(self, straight: Straight) -> None:
        tracks = Tracks.from_table("made", straight((1, 0.0, 0.0, 10.0), frames=85), None)
        frames = sum(int(b.target.sum()) for b in scene_batches([tracks], stride=1))
        assert frames == 85 - 30 - 50

    def test_in_regions_of_interest_each_target_keeps_its_neighbours_and_their_ways(
        self, straight: Straight, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Three cars 20 m apart, looked at from 25 m; the lanes of the first and of the last bend."""
        pose = np.arange(2 * FRAMES * 3, dtype=np.float64).reshape(2, FRAMES, 3)
        monkeypatch.setattr(Tracks, "lane_frames", lambda _, __: LaneFrames(np.array([0, 2]), pose))
        cars = straight(*((k, 20.0 * k, 0.0, 10.0 + k) for k in (1, 2, 3)), frames=81)
        tracks = Tracks.from_table("made", cars, None)
        whole = only(list(scene_batches([tracks], stride=1)))
        batch = only(list(scene_batches([tracks], stride=1, roi_m=25.0, agents_per_batch=999)))
        assert [mask.nonzero().flatten().tolist() for mask in batch.target] == [[0], [1], [1]]
        assert batch.agent.sum(dim=1).tolist() == [2, 3, 2]
        assert torch.equal(batch.history[batch.target], whole.history[0])
        assert torch.equal(batch.future[batch.target], whole.future[0])
        assert batch.state[1, :, 2].tolist() == whole.state[0, :, 2].tolist()
        rows = batch.agent.shape[1]
        assert batch.lane_frames.row.tolist() == [0, rows + 0, rows + 2, 2 * rows + 1]
        assert np.array_equal(batch.lane_frames.pose, pose[[0, 0, 1, 1]])

    def test_a_hole_in_a_track_is_not_bridged(self, straight: Straight) -> None:
        rows = straight((1, 0.0, 0.0, 10.0), frames=90)
        tracks = Tracks.from_table("made", rows[rows["frame"] != 20], None)
        inputs = cut_scene(tracks, tracks.rows_at(30)).inputs  # frame 20 is five steps back
        assert not inputs.observed[0, HISTORY - 1 - 5] and inputs.observed[0].sum() == HISTORY - 1
        assert not inputs.history[0, HISTORY - 1 - 5].any()

    def test_mirrored_scenes_are_the_other_way_round(self, straight: Straight) -> None:
        tracks = Tracks.from_table("made", straight((1, 150.0, -5.5, 10.0), (2, 170.0, -9.0, 8.0)), NET)
        rng = np.random.default_rng
        plain = next(training_batches([(tracks, 1.0)], 2, 30, UNVARIED, rng(0)))
        turned = next(training_batches([(tracks, 1.0)], 2, 30, replace(UNVARIED, mirror=1.0), rng(0)))
        assert torch.equal(turned.history[..., 0], plain.history[..., 0])
        assert torch.equal(turned.history[..., 1], -plain.history[..., 1])
        assert torch.equal(turned.position, plain.position * torch.tensor([1.0, -1.0]))
        assert torch.equal(turned.raster[:, :, :3], plain.raster[:, :, :3].flip(-1))
        assert torch.equal(turned.raster[:, :, SINE].int() - 128, 128 - plain.raster[:, :, SINE].flip(-1).int())

    def test_a_stretched_scene_is_traffic_at_another_speed(self, straight: Straight) -> None:
        # Along the road of the net and a little across it; one is a lane beside and behind.
        table = straight((1, 150.0, -5.5, 10.0), (2, 170.0, -9.0, 8.0))
        table["y"] += 0.02 * table["frame"]
        table["yaw"], table["speed"] = np.arctan2(0.2, table["speed"]), np.hypot(0.2, table["speed"])
        tracks = Tracks.from_table("made", table, NET)
        stretch = replace(UNVARIED, stretch=1.0, stretch_by=(1.5, 1.5))
        plain, long = (
            next(training_batches([(tracks, 1.0)], 2, 30, how, np.random.default_rng(0))) for how in (UNVARIED, stretch)
        )
        near = partial(torch.testing.assert_close, atol=1e-4, rtol=1e-5)
        along = torch.tensor([1.5, 1.0])
        near(long.history[..., :2], plain.history[..., :2] * along)
        near(long.future, plain.future * along)
        near(long.position[0, 1] - long.position[0, 0], (plain.position[0, 1] - plain.position[0, 0]) * along)
        for channels, yaw, speed in (("history", 2, 3), ("state", 3, 2)):
            before, after = getattr(plain, channels), getattr(long, channels)
            near(after[..., speed] * after[..., yaw].cos(), 1.5 * before[..., speed] * before[..., yaw].cos())
            near(after[..., speed] * after[..., yaw].sin(), before[..., speed] * before[..., yaw].sin())
        assert torch.equal(long.state[..., :2], plain.state[..., :2])
        assert torch.equal(long.raster, plain.raster)
        assert torch.equal(long.maneuver, plain.maneuver)

    def test_scenes_of_several_roads_are_not_stretched(self, straight: Straight) -> None:
        table = straight((1, 150.0, -5.5, 10.0), (2, 170.0, -9.0, 8.0))
        table.loc[table["vehicle_id"] == 2, "yaw"] = 0.5 * np.pi
        tracks = Tracks.from_table("made", table, None)
        stretch = replace(UNVARIED, stretch=1.0, stretch_by=(1.5, 1.5))
        plain, same = (
            next(training_batches([(tracks, 1.0)], 2, 30, how, np.random.default_rng(0))) for how in (UNVARIED, stretch)
        )
        assert plain.agent.sum() == 2
        assert torch.equal(same.history, plain.history) and torch.equal(same.position, plain.position)

    def test_occluded_agents_are_seen_now_at_least(self, straight: Straight) -> None:
        tracks = Tracks.from_table("made", straight((1, 150.0, -5.5, 10.0), frames=200), None)
        hide = replace(UNVARIED, occlude=1.0)
        seen = [b.observed[0, 0] for b in training_batches([(tracks, 1.0)], 1, 1, hide, np.random.default_rng(0))]
        assert all(bool(row[-1]) for row in seen)
        assert len({int(row.sum()) for row in seen}) > 5

    def test_of_fewer_vehicles_to_learn_the_others_are_still_seen(self, straight: Straight) -> None:
        vehicles = [(k, 20.0 * k, 0.0, 10.0) for k in range(8)]
        tracks = Tracks.from_table("made", straight(*vehicles, frames=60), None)
        first_ids = set()
        for seed in range(20):
            fewer = tracks.learned_of(0.25, np.random.default_rng(seed))
            one, other = np.unique(fewer.vehicle[fewer.target])
            assert other - one in (1, 7), "neighbours, or the last and the first"
            first_ids.add(int(one))
            batch = next(training_batches([(fewer, 1.0)], 8, 10, UNVARIED, np.random.default_rng(0)))
            assert int(batch.agent.sum()) == 8 and int(batch.target.sum()) == 2
        assert len(first_ids) > 3
        assert np.array_equal(tracks.learned_of(1.0, np.random.default_rng(0)).target, tracks.target)
        assert tracks.learned_of(0.01, np.random.default_rng(0)).target.sum() == 60

    def test_moments_without_anybody_to_learn_are_none(self, straight: Straight) -> None:
        table = straight((1, 0.0, 0.0, 10.0), frames=120)
        tracks = Tracks.from_table("made", table, None, np.asarray(table["frame"] >= 60))
        batches = list(training_batches([(tracks, 1.0)], 3, 1, UNVARIED, np.random.default_rng(0)))
        assert len(batches) == 60 / 3, "they fill no batches either"
        assert sum(int(batch.target.sum()) for batch in batches) == 60 - 2  # the last two have no future

    def test_an_interruption_while_workers_are_started_is_not_lost(self, straight: Straight) -> None:
        tracks = Tracks.from_table("made", straight((1, 150.0, -5.5, 10.0)), NET)
        once = [signal.SIGINT]
        os.register_at_fork(after_in_parent=lambda: os.kill(os.getpid(), once.pop()) if once else None)
        with pytest.raises(KeyboardInterrupt):
            training_batches([(tracks, 1.0)], 8, 10, UNVARIED, np.random.default_rng(0), workers=1)
        assert not once

    def test_epochs_depend_on_their_seed_alone(self, straight: Straight) -> None:
        tracks = Tracks.from_table("made", straight((1, 150.0, -5.5, 10.0), (2, 170.0, -9.0, 8.0)), NET)

        def epoch(seed: int) -> list[SceneBatch]:
            return list(training_batches([(tracks, 1.0)], 8, 10, Augmentation(), np.random.default_rng(seed)))

        first, again, other = epoch(1), epoch(1), epoch(2)
        assert all(torch.equal(a.history, b.history) for a, b in zip(first, again, strict=True))
        assert not all(
            a.history.shape == b.history.shape and torch.equal(a.history, b.history)
            for a, b in zip(first, other, strict=False)
        )


class TestSources:
    def test_pedestrians_and_cyclists_are_left_out_as_in_runs(self, straight: Straight) -> None:
        table = straight((1, 150.0, -5.5, 10.0), (2, 155.0, -8.5, 1.0), (3, 160.0, -9.0, 5.0))
        table["kind"] = table["vehicle_id"].map({1: Kind.CAR, 2: Kind.PEDESTRIAN, 3: Kind.BICYCLE}).astype(np.uint8)
        seen = Tracks.from_table("made", table, None, np.asarray(table["frame"] >= 60))
        alone = Tracks.from_table("made", straight((1, 150.0, -5.5, 10.0)), None)
        assert np.array_equal(seen.vehicle, alone.vehicle) and np.array_equal(seen.motion, alone.motion)
        assert np.array_equal(seen.target, seen.frame >= 60)
        with pytest.raises(InputError, match="made: holds only pedestrians and cyclists"):
            Tracks.from_table("made", table[table["vehicle_id"] > 1], None)

    @pytest.mark.data
    def test_no_test_vehicle_is_in_what_is_trained_on(self) -> None:
        if not (DATA_FOLDER / WINDOWS).is_file():
            pytest.skip("LITSIM_DATA names no folder with the US-101 windows")
        locate = Locator(DATA_FOLDER)
        frames = {"test_frames": TEST_FRAMES}
        windows = load(Us101WindowSource(kind="us101_windows", file=WINDOWS, **frames), locate)
        singles = load(Us101TrackSource(kind="us101_tracks", file=TRACKS, windows=WINDOWS, **frames), locate)
        test = windows["test"][0]
        train = windows["train"][0]
        assert not set(test.vehicle) & set(train.vehicle)
        for tracks in [*singles["train"], *singles["val"]]:
            assert not set(tracks.vehicle) & {vehicle for vehicle in test.vehicle if vehicle < UNKNOWN_IDS}
            # Leaders are known by headways only, and might be test vehicles: nothing of the test's time is seen at all.
            assert not ((tracks.frame >= TEST_FRAMES[0]) & (tracks.frame <= TEST_FRAMES[1])).any()
        assert not set(singles["train"][0].vehicle) & set(singles["val"][0].vehicle[singles["val"][0].target])

    @pytest.mark.data
    def test_where_windows_validate_nothing_of_their_time_is_trained_on(self) -> None:
        if not (DATA_FOLDER / WINDOWS).is_file():
            pytest.skip("LITSIM_DATA names no folder with the US-101 windows")
        locate, frames = Locator(DATA_FOLDER), {"test_frames": TEST_FRAMES}
        windows = load(Us101WindowSource(kind="us101_windows", file=WINDOWS, part="val", **frames), locate)
        assert set(windows) == {"val", "test"} and not set(windows["val"][0].vehicle) & set(windows["test"][0].vehicle)
        last = int(windows["val"][0].frame.max())
        tracks = {"kind": "us101_tracks", "file": TRACKS, "windows": WINDOWS, **frames}
        all_of, apart = (
            load(Us101TrackSource(**tracks, untrained_frames=untrained), locate) for untrained in (None, (0, last))
        )
        assert apart["train"][0].frame.min() > last
        assert np.array_equal(np.unique(all_of["val"][0].vehicle), np.unique(apart["val"][0].vehicle))
        later = all_of["train"][0].frame > last
        assert (all_of["train"][0].target & later).sum() == apart["train"][0].target.sum()

    def test_pairs_are_followers_and_leaders_along_a_lane_and_share_nobody_with_validation(
        self, tmp_path: Path
    ) -> None:
        """Ten pairs one after the other in one lane; of three, somebody is in another pair as well."""
        others = {3: {"follower": 1002}, 6: {"leader": 107}, 8: {"leader": 106}}  # number 7 is for validation
        frames, rows = np.arange(5), []
        for pair in range(10):
            ids = {"follower": 100 + pair, "leader": 1000 + pair} | others.get(pair, {})
            front = 1000.0 * pair + 0.5 * frames
            columns = {"period": 1600, "pair": pair, "lane": 2, **ids, "frame": frames, "follower_y_m": front}
            columns |= {"leader_y_m": front + 12.0, "leader_length_m": 3.5 + pair}
            rows.append(pd.DataFrame(columns | {"follower_speed_mps": 5.0, "leader_speed_mps": 6.0}))
        pd.concat(rows).to_parquet(tmp_path / "pairs.parquet")
        parts = load(I80PairSource(kind="i80_pairs", file="pairs.parquet"), Locator(tmp_path))
        (val,), (train,) = parts["val"], parts["train"]
        assert set(val.vehicle) == {107, 1007}
        left = [pair for pair in range(10) if pair not in (6, 7)]
        named = [{"follower": 100 + p, "leader": 1000 + p} | others.get(p, {}) for p in left]
        assert set(train.vehicle) == {number for pair in named for number in pair.values()}
        follower, leader = (train.rows_at(2)[np.isin(train.vehicle[train.rows_at(2)], v)] for v in (100, 1000))
        assert train.motion[follower, 0] == pytest.approx(1.0 - 2.35)
        assert train.motion[leader, 0] == pytest.approx(13.0 - 1.75)
        assert train.motion[leader, 3] == pytest.approx(6.0) and train.size[leader, 0] == pytest.approx(3.5)
        # Who leads in one pair and follows in another has one length; a lane is straight and without a map.
        assert set(train.size[train.vehicle == 1002, 0]) == {3.5 + 2}
        assert set(train.size[train.vehicle == 106, 0]) == {3.5 + 8}
        assert not train.motion[:, 1:3].any() and train.target.all()

    def test_missing_files_and_columns_are_named(self, tmp_path: Path) -> None:
        source = Us101TrackSource(kind="us101_tracks", file="a.parquet", windows="a.parquet", test_frames=(0, 1))
        with pytest.raises(InputError, match=r"a\.parquet: no such file"):
            load(source, Locator(tmp_path))
        pd.DataFrame({"frame": [1]}).to_parquet(tmp_path / "a.parquet")
        with pytest.raises(InputError, match="missing columns"):
            load(source, Locator(tmp_path))
