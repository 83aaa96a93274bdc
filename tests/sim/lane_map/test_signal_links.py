"""Controlled connections of a net, and who passes their stop lines."""

from pathlib import Path

import numpy as np
import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import PASSED, SignalLink, crossings, read_links
from litsim_sim.scenario.scenario import packaged

URBAN = packaged("nets/urban_like.net.xml")
SPEED = 10.0


@pytest.fixture(scope="module")
def links() -> tuple[SignalLink, ...]:
    return read_links(URBAN)


def drive(way: np.ndarray, length: float = 4.0, reach: float = 0.0) -> tuple[np.ndarray, ...]:
    """Box centres and headings (1, steps) of a car whose front follows `way` at SPEED until `reach` m, or its end."""
    along = np.r_[0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T))]
    s = np.arange(0.0, reach or along[-1], SPEED * STEP_S)
    front = np.stack([np.interp(s, along, way[:, k]) for k in (0, 1)], axis=-1)
    yaw = np.unwrap(np.arctan2(*np.gradient(front, axis=0).T[::-1]))
    centre = front - 0.5 * length * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return centre[None, :, 0], centre[None, :, 1], yaw[None]


def passed(links: tuple[SignalLink, ...], car: tuple[np.ndarray, ...]) -> list[tuple[int, str]]:
    x, y, yaw = car
    found = crossings(links, x, y, yaw, np.array([4.0]), np.ones(x.shape, np.bool_))
    assert (found.agent == 0).all()
    return [(int(step), links[link].name) for step, link in zip(found.step, found.link, strict=True)]


def test_links_are_those_of_the_net(links: tuple[SignalLink, ...]) -> None:
    assert [link.name for link in links] == sorted(link.name for link in links)
    by_name = {link.name: link for link in links}
    left = by_name["WA_2 -> AAN_0"]
    assert (left.light, left.index, left.via) == ("A", 3, (":A_13_0", ":A_17_0"))
    assert left.stop.tolist() == [-114.6, -1.65]
    assert (left.heading, left.exit_heading) == pytest.approx((0.0, np.pi / 2))
    assert left.exit.tolist() == [-98.35, 17.9]
    assert left.junction == "A" and left.turns and not by_name["WA_1 -> AB_1"].turns
    oncoming, cross = {"BA_0 -> AW_0", "BA_1 -> AW_1", "BA_0 -> AAN_0"}, {"ANA_0 -> AAS_0", "ANA_1 -> AB_1"}
    assert set(left.foes) == oncoming | cross | {"ASA_0 -> AAN_0", "ASA_1 -> AW_1"}
    assert all(link.name in by_name[foe].foes for link in links for foe in link.foes)

    assert read_links(packaged("nets/us101_like.net.xml")) == ()
    with pytest.raises(InputError, match="no such net"):
        read_links(Path("absent.net.xml"))


@pytest.mark.parametrize("name", ["WA_0 -> AAS_0", "WA_0 -> AB_0", "WA_2 -> AAN_0", "BSB_1 -> BA_1", "ANA_0 -> AW_0"])
def test_every_way_over_a_junction_is_told_apart(links: tuple[SignalLink, ...], name: str) -> None:
    lanes = LaneMap.from_net(URBAN)
    link = next(each for each in links if each.name == name)
    ways = [lanes.lanes[lanes.row(lane)].centerline for lane in (link.from_lane, *link.via, link.to_lane)]
    ways[0] = np.stack([ways[0][-1] - 30.05 * np.array([np.cos(link.heading), np.sin(link.heading)]), ways[0][-1]])
    ((step, found),) = passed(links, drive(np.concatenate(ways)))
    assert found == name
    assert step == np.ceil((30.05 + PASSED) / (SPEED * STEP_S))


def test_who_waits_in_the_junction_has_taken_the_way_that_it_takes_then(links: tuple[SignalLink, ...]) -> None:
    x, y, yaw = drive(np.array([[-150.0, -8.25], [-60.0, -8.25]]))
    waits = int(np.searchsorted(x[0], -110.0))  # nearer to where the right turn leaves the junction
    at = np.r_[:waits, np.full(200, waits), waits : x.shape[1]]
    ((_, found),) = passed(links, (x[:, at], y[:, at], yaw[:, at]))
    assert found == passed(links, (x, y, yaw))[0][1] == "WA_0 -> AB_0"


def test_who_stops_on_the_line_has_not_passed(links: tuple[SignalLink, ...]) -> None:
    way = np.array([[-150.0, -4.95], [-80.0, -4.95]])
    to_line = -114.6 + 150.0
    assert not passed(links, drive(way, reach=to_line + 0.6))
    assert len(passed(links, drive(way, reach=to_line + 2.5))) == 1


@pytest.mark.parametrize(("back", "times"), [(0.05, 1), (0.9, 1), (1.1, 7)])
def test_who_rocks_back_and_forth_beyond_the_line_passes_once_and_who_comes_back_to_it_again(
    links: tuple[SignalLink, ...], back: float, times: int
) -> None:
    x, y, yaw = drive(np.array([[-150.0, -4.95], [-80.0, -4.95]]))
    stands = int(np.searchsorted(x[0] + 2.0, -114.6 + PASSED))
    at = np.r_[:stands, np.full(12, stands), stands : x.shape[1]]
    x, y, yaw = x[:, at], y[:, at], yaw[:, at]
    x[0, stands : stands + 12] = -114.6 - 2.0 + PASSED + 0.01 - np.tile([0.0, back], 6)
    found = passed(links, (x, y, yaw))
    assert len(found) == times
    assert found[-1][0] == stands + 12, "when it drives on"


def test_other_directions_and_lanes_do_not_count(links: tuple[SignalLink, ...]) -> None:
    assert not passed(links, drive(np.array([[-80.0, -4.95], [-150.0, -4.95]])))  # backwards
    assert not passed(links, drive(np.array([[-150.0, -14.0], [-80.0, -14.0]])))  # beside the road
    from_exit = np.array([[-98.35, 0.0], [-98.35, 60.0]])  # out of the junction
    assert not passed(links, drive(from_exit))
