"""OpenSCENARIO files of others: start times, positions, parameters, catalogs, and what is not read."""

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest

from litsim_data.cli import main
from litsim_data.sources.openscenario.conditions import Conditions
from litsim_data.sources.openscenario.source import OpenScenario
from litsim_data.sources.openscenario.storyboard import Storyboard
from litsim_data.sources.openscenario.xml import UnreadError, value_of
from litsim_data.sources.source import Scene
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import Scenario
from made_maps import opendrive, road
from made_openscenario import (
    ABSOLUTE,
    AT,
    CAR,
    CHANGE,
    PLAIN,
    RELATIVE,
    SPEED,
    STAND,
    STATE,
    UNTIMED,
    VAN,
    act,
    follow,
    when,
    when_of,
    world,
    write,
)


def scene_of(path: Path) -> tuple[dict[str, pd.DataFrame], Scene]:
    (scene,) = OpenScenario().read(path, None)
    table = scene.tracks.table  # type: ignore[attr-defined]
    frames = (10.0 * table["time"]).round().astype(int)
    return {name: track.set_index(frames[track.index]) for name, track in table.groupby("vehicle_id")}, scene


EAST = {0.0: world(-80.0), 10.0: world(20.0)}
"""A way of 10 m/s."""


def NOBODY(condition: ET.Element) -> list[tuple[float, float]]:  # noqa: N802 - there are no entities
    Conditions.check(condition)
    return []


STOP = when(AT.format(20, "greaterThan"), tag="StopTrigger")


@pytest.mark.parametrize(
    ("of_act", "of_event", "start"),
    [
        ("<StartTrigger/>", when(AT.format(5, "greaterThan")), 5.0),
        (when(AT.format(3, "greaterThan")), when(AT.format(0, "greaterThan")), 3.0),
        (when(AT.format(1, "greaterThan"), delay=2.0), "", 3.0),
        ("<StartTrigger/>", when(AT.format(5, "lessThan"), edge="falling"), 5.0),
        (when(AT.format(2, "greaterThan")), when(AT.format(0, "greaterThan"), edge="rising"), 2.0),
        ("<StartTrigger/>", when(AT.format(4, "equalTo"), delay=0.5), 4.5),
        ("<StartTrigger/>", when(AT.format(4, "lessThan"), delay=0.5), 0.5),
        (when(AT.format(1, "lessThan"), tag="StopTrigger"), when(AT.format(2, "greaterThan")), np.inf),
        (when(AT.format(4, "greaterOrEqual")), when(AT.format(4, "lessThan")), np.inf),
        ("<StartTrigger/>", when(AT.format(2, "greaterThan"), AT.format(6, "greaterThan")), 6.0),
        ("<StartTrigger/>", when(STATE.format("event", "b::first", "endTransition"), delay=1.0), 3.0),
        ("<StartTrigger/>", when(STATE.format("act", "b", "completeState")), 2.0),
        ("<StartTrigger/>", when(STATE.format("action", "first_action", "runningState")), 0.0),
    ],
)
def test_start_times(of_act: str, of_event: str, start: float) -> None:
    others = act("b", "B", {"first": ("<GlobalAction/>", "")})
    root = ET.fromstring(f"<R><Story name='s'>{act('a', 'A', {'e': ('', of_event)}, of_act)}{others}</Story></R>")
    (event,) = root.findall(".//Event[@name='e']")
    assert Storyboard(root, lambda _, begin: (begin + 2.0, False), NOBODY).start(event) == pytest.approx(start)


@pytest.mark.parametrize(
    ("trigger", "why"),
    [
        (when(when_of("Ego", "<AngleCondition/>")), "element AngleCondition is not read"),
        (when(STATE.format("event", "e", "endTransition")), "element Event e waits for itself"),
        (when(STATE.format("event", "gone", "endTransition")), "there is no event gone"),
        (when(AT.format("soon", "greaterThan")), "attribute value is soon, expected a number"),
        (when(AT.format(1, "about")), "rule about is not read"),
    ],
)
def test_start_times_that_are_not_known(trigger: str, why: str) -> None:
    root = ET.fromstring(f"<R><Story name='s'>{act('a', 'A', {'e': ('', trigger)})}</Story></R>")
    (event,) = root.findall(".//Event")
    with pytest.raises(UnreadError, match=re.escape(why)):
        Storyboard(root, lambda _, begin: (begin, False), NOBODY).start(event)


REF = 'entityRef="B" freespace="{}" rule="lessThan" value="{}"'
TARGET = '<TimeToCollisionConditionTarget><EntityRef entityRef="B"/></TimeToCollisionConditionTarget>'
PLACE = "<Position>" + world("{}") + "</Position>"


@pytest.mark.parametrize(
    ("who", "condition", "start"),
    [
        ("Ego", '<SpeedCondition rule="greaterThan" value="12"/>', 18.0),
        ("Ego", '<AccelerationCondition rule="greaterThan" value="0.5"/>', 16.0),
        ("Ego", '<TraveledDistanceCondition value="30"/>', 3.0),
        ("Ego", f'<ReachPositionCondition tolerance="2">{PLACE.format(-50)}</ReachPositionCondition>', 4.8),
        (
            "Ego",
            f'<DistanceCondition freespace="false" rule="lessThan" value="30">{PLACE.format(0)}</DistanceCondition>',
            7.0,
        ),
        ("Ego", f'<RelativeDistanceCondition relativeDistanceType="longitudinal" {REF.format("false", 20)}/>', 13.0),
        ("Ego", f'<RelativeDistanceCondition relativeDistanceType="longitudinal" {REF.format("true", 20)}/>', 12.5),
        (
            "Ego",
            f'<RelativeDistanceCondition relativeDistanceType="cartesianDistance" {REF.format("true", 20)}/>',
            12.5,
        ),
        ("Ego", f'<TimeHeadwayCondition alongRoute="true" {REF.format("false", 2)}/>', 13.0),
        ("B", f"<TimeHeadwayCondition {REF.format('false', 2).replace('B', 'Ego')}/>", np.inf),
        (
            "Ego",
            f"<TimeToCollisionCondition {REF.format('true', 2)}>{TARGET}</TimeToCollisionCondition>",
            12.5,
        ),
        ("Ego", '<RelativeSpeedCondition entityRef="B" rule="greaterThan" value="5"/>', 0.0),
        ("Ego", '<CollisionCondition><EntityRef entityRef="B"/></CollisionCondition>', 14.5),
        ("B", '<StandStillCondition duration="2"/>', 2.0),
        ("Ego", '<EndOfRoadCondition duration="0"/>', 23.0),
    ],
)
def test_conditions_on_entities(who: str, condition: str, start: float, tmp_path: Path) -> None:
    """Ego drives at 10 m/s from x = -100 m, and from 16 s on with 1 m/s2 to 14 m/s; B stands at 50 m, and W waits."""
    cars = dict.fromkeys(("Ego", "B", "W"), PLAIN)
    at = {name: STAND.format(world(x)) for name, x in (("Ego", -100.0), ("B", 50.0), ("W", -140.0))}
    at["Ego"] += SPEED.format(shape="step", lasts=0, speed=10.0)
    faster = act(
        "f", "Ego", {"f": (SPEED.format(shape="linear", lasts=4, speed=14.0), when(AT.format(16, "greaterThan")))}
    )
    goes = act("a", "W", {"e": (SPEED.format(shape="step", lasts=0, speed=5.0), when(when_of(who, condition)))})
    stop = when(AT.format(30, "greaterThan"), tag="StopTrigger")
    tracks, _ = scene_of(write(tmp_path, cars, at, faster + goes, stop))
    moves = tracks["W"]["x"] > -140.0 + 1e-6
    begins = 0.1 * (int(moves.idxmax()) - 1) if moves.any() else np.inf
    assert begins == pytest.approx(start, abs=0.11)


def test_a_scenario_that_ends_at_once_tells_no_acceleration(tmp_path: Path) -> None:
    faster = when(when_of("Ego", '<AccelerationCondition rule="lessThan" value="0.5"/>'))
    goes = act("a", "Ego", {"e": (SPEED.format(shape="step", lasts=0, speed=5.0), faster)})
    stop = when(AT.format(0, "greaterOrEqual"), tag="StopTrigger")
    with pytest.raises(InputError, match="nothing says when it ends"):
        scene_of(write(tmp_path, {"Ego": PLAIN}, {"Ego": STAND.format(world(0.0))}, goes, stop))


def test_who_changes_lanes_because_of_another_and_what_follows_from_that(tmp_path: Path) -> None:
    """Ego goes right 20 m behind B, then drives 20 m/s; C keeps to Ego's speed; all ends as Ego is at x = 100 m."""
    change = CHANGE.format(target="<RelativeTargetLane entityRef='Ego' value='-1'/>")
    same = SPEED.format(shape="step", lasts=0, speed=0.0).replace(
        "AbsoluteTargetSpeed", "RelativeTargetSpeed entityRef='Ego' speedTargetValueType='delta' continuous='true'"
    )
    near = when_of("Ego", f'<RelativeDistanceCondition relativeDistanceType="longitudinal" {REF.format("false", 20)}/>')
    done = when(STATE.format("event", "aside", "endTransition"))
    cars = dict.fromkeys(("Ego", "B", "C"), PLAIN)
    at = {name: STAND.format(world(x)) for name, x in (("Ego", -100.0), ("B", 0.0), ("C", -140.0))}
    at["Ego"] += SPEED.format(shape="step", lasts=0, speed=10.0)
    acts = act(
        "a", "Ego", {"aside": (change, when(near)), "on": (SPEED.format(shape="step", lasts=0, speed=20.0), done)}
    )
    acts += act("c", "C", {"follows": (same, "")})
    there = f'<ReachPositionCondition tolerance="4">{PLACE.format(100)}</ReachPositionCondition>'
    path = write(tmp_path, cars, at, acts, when(when_of("Ego", there), tag="StopTrigger"))
    path.with_name("made.xodr").write_text(opendrive(road(right=2)))
    tracks, _ = scene_of(path)
    ego, begin = tracks["Ego"], 8.1  # s at which less than 20 m are left
    share = np.clip((ego["time"] - begin) / 4.0, 0.0, 1.0)
    np.testing.assert_allclose(ego["y"], -1.75 - 3.5 * share**2 * (3.0 - 2.0 * share), atol=0.05)
    np.testing.assert_allclose(np.diff(ego["x"])[:110], 1.0, atol=0.03)
    np.testing.assert_allclose(np.diff(ego["x"])[-20:], 2.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(tracks["C"]["x"])[130:], 2.0, atol=0.02)
    assert ego["x"].iloc[-1] == pytest.approx(99.0) and ego["yaw"].abs().max() == pytest.approx(0.131, abs=0.02)


def test_who_waits_stands_or_drives_on_and_who_has_done_drives_on(tmp_path: Path) -> None:
    late = when(AT.format(5, "greaterThan"))
    cars = dict.fromkeys(("Ego", "parked", "waits", "drives"), PLAIN)
    at = {name: STAND.format(world(x)) for name, x in (("parked", 40.0), ("waits", -80.0), ("drives", -100.0))}
    at["drives"] += SPEED.format(shape="step", lasts=0, speed=4.0)
    acts = act("a", "Ego", {"e": (follow(EAST, ABSOLUTE), "")}) + act("b", "waits", {"f": (follow(EAST), late)})
    tracks, scene = scene_of(write(tmp_path, cars, at, acts, STOP))
    assert scene.ego == "Ego" and not scene.notes
    assert all(track.index.tolist() == list(range(201)) for track in tracks.values())
    assert set(tracks["parked"]["x"]) == {40.0} and set(tracks["parked"]["yaw"]) == {0.0}
    np.testing.assert_allclose(tracks["waits"].loc[[0, 50, 51, 150, 200], "x"], [-80.0, -80.0, -79.0, 20.0, 70.0])
    np.testing.assert_allclose(tracks["drives"].loc[[0, 100, 200], "x"], [-100.0, -60.0, -20.0])
    np.testing.assert_allclose(tracks["Ego"].loc[[0, 100, 200], "x"], [-80.0, 20.0, 120.0])


def test_triggering_entities_that_do_not_act_are_told(tmp_path: Path) -> None:
    acts = act("a", "A", {"e": (follow(EAST), "")}).replace("Entities='false'", "Entities='true'")
    _, scene = scene_of(write(tmp_path, {"A": PLAIN}, {"A": STAND.format(world(0.0))}, acts, STOP))
    assert scene.notes == ("entities that trigger ManeuverGroup a_g are not among its actors",)


@pytest.mark.parametrize(
    ("action", "x"),
    [
        (follow(EAST, RELATIVE, "initialDistanceOffset='50'"), [-30.0, -20.0, 20.0]),
        (follow(EAST, ABSOLUTE, "initialDistanceOffset='50'"), [-30.0, -30.0, -30.0]),
        (follow({0.0: world(0.0), 1.0: world(40.0)}, UNTIMED), [0.0, 6.0, 30.0]),
        (SPEED.format(shape="linear", lasts=2, speed=10.0), [0.0, 7.0, 46.0]),
    ],
    ids=["offset", "offset by clock", "without times", "speed"],
)
def test_what_an_entity_does(action: str, x: list[float], tmp_path: Path) -> None:
    first = STAND.format(world(0.0)) + SPEED.format(shape="step", lasts=0, speed=6.0)
    stop = when(AT.format(5, "greaterThan"), tag="StopTrigger")
    tracks, _ = scene_of(write(tmp_path, {"A": PLAIN}, {"A": first}, act("a", "A", {"e": (action, "")}), stop))
    np.testing.assert_allclose(tracks["A"].loc[[0, 10, 50], "x"], x, atol=0.02)


LANE = '<LanePosition roadId="1" laneId="{}" s="100"{}</LanePosition>'


@pytest.mark.parametrize(
    ("place", "pose"),
    [
        (LANE.format(-1, ' offset="0.5">'), (-50.0, -1.25, 0.0)),
        (LANE.format(1, ">"), (-50.0, 1.75, np.pi)),
        (LANE.format(1, '><Orientation type="relative" h="0.25"/>'), (-50.0, 1.75, 0.25)),
        ('<RoadPosition roadId="1" s="30" t="2"/>', (-120.0, 2.0, 0.0)),
        ('<RelativeLanePosition entityRef="other" dLane="1" ds="20" offset="0"/>', (-20.0, 1.75, np.pi)),
        ('<RelativeRoadPosition entityRef="other" ds="-10" dt="1"/>', (-50.0, -0.75, 0.0)),
        ('<RelativeWorldPosition entityRef="other" dx="3" dy="-1"/>', (-37.0, -2.75, 0.0)),
        ('<RelativeObjectPosition entityRef="other" dx="3" dy="1"><Orientation h="1"/>', (-37.0, -0.75, 1.0)),
    ],
)
def test_positions(place: str, pose: tuple[float, float, float], tmp_path: Path) -> None:
    place += "</RelativeObjectPosition>" * ("RelativeObject" in place)
    at = {"A": STAND.format(place), "other": STAND.format(world(-40.0))}
    tracks, _ = scene_of(write(tmp_path, {"A": PLAIN, "other": PLAIN}, at, "", STOP))
    assert tuple(tracks["A"].loc[7, ["x", "y", "yaw"]]) == pytest.approx(pose)


def test_what_is_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "in"
    (folder / "catalogs").mkdir(parents=True)
    (folder / "catalogs" / "vans.xosc").write_text(f'<OpenSCENARIO><Catalog name="vans">{VAN}</Catalog></OpenSCENARIO>')
    van = "<CatalogReference catalogName='vans' entryName='box'/>"
    entities = {"ego": CAR, "van": van, "tram": '<Vehicle name="t" vehicleCategory="tram"/>', "nowhere": PLAIN}
    first = follow({0.1 * k: world(k - 80.0, heading='h="0"') for k in range(31)}, ABSOLUTE)
    late = follow({0.0: world(-110.0), 2.0: world(-90.0)})
    acts = act("a", "van", {"e": (late, when(AT.format(1, "greaterThan")))})
    write(folder, entities, {"ego": first}, acts)
    main(["import", str(folder), str(tmp_path / "out")])
    text = " ".join(capsys.readouterr().out.split())
    assert "2 of 4 entities are left out: tram: element Vehicle of category tram is not simulated; nowhere: no" in text
    recording = Recording.read(tmp_path / "out" / "made.parquet")
    ids, table = recording.header.notes["ids"], recording.table
    ego, van_rows = (table[table["vehicle_id"] == ids[name]] for name in ("ego", "van"))  # type: ignore[index]
    np.testing.assert_allclose(ego["x"], np.arange(0.0, 30.1) - 80.0 + 1.5, atol=1e-6)
    assert set(ego["length"]) == {5.0} and set(van_rows["length"]) == {6.0} and set(table["kind"]) == {Kind.CAR}
    assert van_rows["frame"].tolist() == list(range(10, 31)), "its times count from the start of its event"
    np.testing.assert_allclose(van_rows["x"], np.arange(0.0, 20.1) - 110.0 + 2.0, atol=1e-6)
    (scenario,) = (tmp_path / "out" / "scenarios").glob("*_train_*.yaml")
    assert Scenario.load(scenario).ego_id == ids["ego"]  # type: ignore[index]


KEEP = "<PrivateAction><LateralAction><LateralDistanceAction/></LateralAction></PrivateAction>"


@pytest.mark.parametrize(
    ("entity", "action", "why"),
    [
        (PLAIN, KEEP, "element LateralDistanceAction is not read"),
        (
            PLAIN,
            follow({0.0: world(0.0), 1.0: world("east")}),
            "element WorldPosition: attribute x is east, expected a",
        ),
        (PLAIN, follow({0.0: world(0.0), float("9" * 30): world(9.0)}), "element Vertex: attribute time is 1e+30"),
        (PLAIN, follow({0.0: world(0.0), 1.0: world(400.0)}), "element Vertex 2: is 400 m and 1 s after"),
        (PLAIN, follow({1.0: world(0.0), 0.0: world(4.0)}), "element Vertex: times fall"),
        (PLAIN, STAND.format(LANE.format(-3, ">")), "there is no lane -3 at s 100 of road 1"),
        (PLAIN, STAND.format('<GeoPosition latitude="1" longitude="1"/>'), "element GeoPosition is not read"),
        ("<CatalogReference catalogName='c' entryName='e'/>", "", "entry e of catalog c is in no folder"),
        (PLAIN.replace('x="0.0"', 'x="${1/0}"'), "", "element Center: attribute x is ${1/0}, expected a number"),
    ],
)
def test_who_is_left_out(entity: str, action: str, why: str, tmp_path: Path) -> None:
    places = {name: STAND.format(world(x)) for name, x in (("A", 0.0), ("B", 50.0))}
    acts = act("a", "A", {"e": (action, "")}) if action else ""
    tracks, scene = scene_of(write(tmp_path, {"A": entity, "B": PLAIN}, places, acts, STOP))
    assert {*tracks} == {"B"} and scene.notes[0].startswith(f"1 of 2 entities are left out: A: {why}")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ((STOP, ""), "nothing says when it ends"),
        (("20", "8" * 30), "nothing says when it ends.* the StopTrigger is passed over: .* value is 8888"),
        (('"1.0"?', '"1.0" encoding="no"?'), "not a readable OpenSCENARIO file: unknown encoding"),
        (("</OpenSCENARIO>", ""), "not a readable OpenSCENARIO file"),
        (("TeleportAction", "RunAction"), "holds no entity that is read; 1 of 1 .* element RunAction is not read"),
    ],
)
def test_what_cannot_be_used(change: tuple[str, str], why: str, tmp_path: Path) -> None:
    path = write(tmp_path, {"A": PLAIN}, {"A": STAND.format(world(0.0))}, "", STOP)
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(InputError, match=why):
        scene_of(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("$a", "2.5"),
        ("${$a * 2 + 1}", "6"),
        ("${pow($a, 2) % 4}", "2.25"),
        ("${-round($a)}", "-3"),
        ("${not true or $b}", "true"),
        ("${$gone + 1}", "${$gone + 1}"),
        ("${__import__('os')}", "${__import__('os')}"),
        ("${9**9**9**9}", "${9**9**9**9}"),
    ],
)
def test_expressions(text: str, value: str) -> None:
    assert value_of(text, {"a": "2.5", "b": "true"}) == value
