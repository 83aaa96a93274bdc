from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from litsim_data.encounters.following import CAR_LENGTH, LANES, PAIRS, following_tracks, lanes, pairs, vehicles
from litsim_sim.core.errors import InputError


def lane_file(data: Path, **changes: object) -> None:
    """Writes vehicle 2, 20 m behind car 1, both at 10 m/s for 10 s, with columns that differ."""
    frame = np.arange(100)
    both = [
        pd.DataFrame({"vehicle_id": 1, "local_y_m": 20.0 + frame, "preceding": -1, "preceding_y_m": np.nan}),
        pd.DataFrame({"vehicle_id": 2, "local_y_m": 0.0 + frame, "preceding": 1, "preceding_y_m": 20.0 + frame}),
    ]
    table = pd.concat([part.assign(frame=frame) for part in both], ignore_index=True)
    table = table.assign(period=1600, lane=1, speed_mps=10.0, **{"class": 2}).assign(**changes)
    (data / LANES).parent.mkdir()
    table.to_parquet(data / LANES)


def test_a_vehicle_of_a_lane_follows_the_rear_of_its_leader(tmp_path: Path) -> None:
    lane_file(tmp_path)
    (track,) = lanes(tmp_path)
    assert (track.site, track.period, track.follower, track.leader, track.first_frame) == ("i80", 1600, 2, 1, 1)
    assert np.allclose(track.gap, 20.0 - CAR_LENGTH)
    assert np.allclose(track.speed, 10.0) and np.allclose(track.leader_speed, 10.0)


def test_tracks_end_where_the_leader_jumps(tmp_path: Path) -> None:
    frame = np.tile(np.arange(100), 2)
    lane_file(tmp_path, preceding_y_m=20.0 + frame + 3.0 * (frame >= 45))
    assert [(track.first_frame, len(track)) for track in lanes(tmp_path)] == [(1, 44), (46, 54)]


def test_leaders_other_than_cars_are_none(tmp_path: Path) -> None:
    lane_file(tmp_path, **{"class": 3})
    assert not list(lanes(tmp_path))


def test_a_file_without_leaders_is_refused(tmp_path: Path) -> None:
    (tmp_path / LANES).parent.mkdir()
    pd.DataFrame({"frame": [1]}).to_parquet(tmp_path / LANES)
    with pytest.raises(InputError, match="missing columns"):
        list(lanes(tmp_path))


@pytest.mark.data
def test_real_tracks_keep_behind_their_leaders(real_data: Callable[..., Path]) -> None:
    data = real_data(PAIRS).parents[1]
    by_file = [list(tracks(data)) for tracks in (pairs, lanes, vehicles)]
    assert all(by_file) and len(list(following_tracks(data))) == sum(map(len, by_file))
    assert min(track.gap.min() for tracks in by_file for track in tracks) > 0.0
    assert {track.split for track in by_file[0]} == {"tuning", "reported"}
