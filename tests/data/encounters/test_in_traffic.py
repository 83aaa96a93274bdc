"""Encounters of every kind, in traffic made by hand, and what makes none."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from litsim_data.encounters.encounter import Encounter
from litsim_data.encounters.in_traffic import BLOCK, Traffic
from litsim_data.encounters.lack import Lack
from litsim_data.encounters.origin import Origin
from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import packaged
from made_traffic import MOTORWAY, STREET, Vehicle, braking, changing, lane_y, on_path, straight

AGENT, OPPONENT, THIRD = 1, 2, 3
LEADER = braking(OPPONENT, 60.0, 1, [(0, 14), (5.5, 14), (7.5, 9), (12, 9)])
FOLLOWER = braking(AGENT, 35.0, 1, [(0, 14), (6.5, 14), (8.5, 9), (12, 9)])
CUTS_IN = [(0, 2), (4, 2), (7, 1), (12, 1)]
YIELDS = [(0.0, 8.0), (6.5, 8.0), (8.5, 3.0), (10.0, 3.0), (12.0, 8.0)]
STARTS = [(0.0, 0.0), (5.0, 0.0), (7.5, 6.0), (30.0, 6.0)]


def traffic(*vehicles: Vehicle, lane_map: LaneMap = MOTORWAY) -> Traffic:
    table = pd.concat([vehicle.rows() for vehicle in vehicles], ignore_index=True)
    recording = Recording.from_table(RecordingHeader("made"), table, "made")
    net = "us101_like" if lane_map is MOTORWAY else "urban_like"
    return Traffic(recording, Origin("made", "made", packaged(f"nets/{net}.net.xml"), lane_map), "made")


def found(where: Traffic) -> list[Encounter]:
    return [encounter for block in where.blocks for encounter in where.encounters(block)]


def test_a_leader_that_brakes_does_not_in_the_log() -> None:
    (encounter,) = found(traffic(LEADER, FOLLOWER, straight(THIRD, 20.0, 15.0, 3)))
    log, note, onset = encounter.scenario.log, encounter.note, encounter.note.onset_step
    assert (note.kind, note.agent, note.opponent, onset) == ("leader_brakes", AGENT, OPPONENT, 50)
    assert np.allclose(log.speed[:2, onset:], 14.0, atol=0.2)
    assert encounter.opponent_truth.speed[-1] == pytest.approx(9.0, abs=0.1)
    assert encounter.people.speed_lost == pytest.approx(5.0, abs=0.3)


def test_everybody_else_is_as_recorded() -> None:
    third = changing(THIRD, 20.0, 15.0, [(0, 3), (6, 3), (9, 4), (12, 4)])
    (encounter,) = found(traffic(LEADER, FOLLOWER, third))
    columns = encounter.scenario.recording.columns
    own = columns["vehicle_id"] == THIRD
    assert np.array_equal(columns["y"][own], third.y[columns["frame"][own]])


@pytest.mark.parametrize(("kind", "lane"), [("cut_in", 1), ("merge", 4)])
def test_who_comes_into_the_lane_stays_in_its_own_in_the_log(kind: str, lane: int) -> None:
    other = changing(OPPONENT, 190.0, 12.0, [(0, lane + 1), (4, lane + 1), (7, lane), (12, lane)])
    agent = braking(AGENT, 155.0, lane, [(0, 15), (5, 15), (7, 12), (12, 12)])
    (encounter,) = found(traffic(agent, other))
    log = encounter.scenario.log
    assert (encounter.note.kind, encounter.note.agent, encounter.note.opponent) == (kind, AGENT, OPPONENT)
    assert encounter.opponent_truth.y[-1] == pytest.approx(lane_y(lane), abs=0.1)
    assert log.y[1, -1] == pytest.approx(lane_y(lane + 1), abs=0.6)


@pytest.mark.parametrize(
    ("kind", "agent", "opponent"),
    [
        ("crossing", on_path(AGENT, ("WA_0", "AB_0"), 85.0, YIELDS), ("ASA_0", "AAN_0")),
        ("turning", on_path(AGENT, ("BA_1", "AW_1"), 115.0, YIELDS), ("WA_2", "AAN_0")),
    ],
)
def test_who_starts_across_the_way_does_not_touch_in_the_log(
    kind: str, agent: Vehicle, opponent: tuple[str, str]
) -> None:
    length = STREET.lanes[STREET.row(opponent[0])].length
    (encounter,) = found(traffic(agent, on_path(OPPONENT, opponent, length - 4.0, STARTS), lane_map=STREET))
    assert (encounter.note.kind, encounter.note.agent, encounter.note.opponent) == (kind, AGENT, OPPONENT)
    log, people = encounter.scenario.log, encounter.people
    apart = np.hypot(log.x[0] - log.x[1], log.y[0] - log.y[1])
    assert apart.min() > 2.0 and not people.contact
    assert people.speed_lost == pytest.approx(5.0, abs=0.2)


@pytest.mark.parametrize(
    ("lack", "vehicles"),
    [
        (Lack.SHORT, (LEADER, replace(FOLLOWER, x=FOLLOWER.x[:90], y=FOLLOWER.y[:90]))),
        (Lack.OTHERS, (LEADER, FOLLOWER, straight(THIRD, 82.0, 9.0, 1.51))),
        (Lack.RECORD, (changing(OPPONENT, 190.0, 12.0, CUTS_IN), straight(AGENT, 155.0, 15.0, 1))),
        (Lack.EASY, (changing(OPPONENT, 60.0, 14.0, CUTS_IN), straight(AGENT, 40.0, 12.0, 1))),
    ],
)
def test_what_makes_no_encounter_is_counted(lack: Lack, vehicles: tuple[Vehicle, ...]) -> None:
    where = traffic(*vehicles)
    assert not found(where)
    assert where.left_out[lack] == 1


def test_encounters_of_one_agent_do_not_overlap_and_blocks_share_none() -> None:
    slow = [(0, 14), (5, 14), (7, 9), (9, 9), (11, 14), (12, 14)]
    t = np.arange(2 * BLOCK) * 0.1
    speed = np.interp(t % 60.0, *zip(*slow, strict=True))
    way = np.append(0.0, np.cumsum(0.05 * (speed[1:] + speed[:-1])))
    ring = [Vehicle(number, (x + way), np.full(len(t), lane_y(1))) for number, x in ((AGENT, 0.0), (OPPONENT, 25.0))]
    where = traffic(*ring)
    frames = [encounter.scenario.start_frame + encounter.note.onset_step for encounter in found(where)]
    assert np.all(np.diff(frames) > 60)


def test_a_scenario_brings_its_own_net() -> None:
    where = Traffic.of("demo", None, Counter())
    assert where.origin.net.name == "us101_like.net.xml"
    with pytest.raises(InputError, match="--net: demo is a scenario, which names its net"):
        Traffic.of("demo", "us101", Counter())
