"""Runs, scenarios and nets in the formats of others, read back by our readers and judged by their authors' checkers."""

import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest

import made_sources
from command_line import refusal
from litsim_data.cli import main
from litsim_data.exports.commonroad import CommonRoad
from litsim_data.exports.export import Content, format_of
from litsim_data.exports.opendrive import OpenDrive
from litsim_data.exports.openscenario import OpenScenario
from litsim_data.exports.sumo import SumoTrajectories
from litsim_data.maps.lane_graph import LaneGraph, Lanelet, around
from litsim_data.maps.net_builder import write_graph
from litsim_data.maps.netconvert import import_opendrive, is_left_hand
from litsim_data.sources.source import source_of
from litsim_sim.core.scene import Kind
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import Signals

COMMONROAD = Path(__file__).parents[3] / "examples/commonroad_planner/.venv/bin/python"
FIRST = 700  # frame


@pytest.fixture(scope="module")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The net of the made crossing."""
    path = tmp_path_factory.mktemp("net") / "crossing.net.xml"
    write_graph(LaneGraph(tuple(made_sources.lanes())), path)
    return path


def content(net: Path) -> Content:
    """On the crossing: a car that turns, a truck that comes later, a bicycle that leaves early, a pedestrian."""
    step = np.arange(40)
    t, angle = 0.1 * step, 0.03 * step
    agents = {
        3: (step, {"x": 50.0 * np.sin(angle) - 60.0, "y": 50.0 - 50.0 * np.cos(angle), "yaw": angle, "speed": 15.0}),
        8: (step[12:], {"x": (30.0 + 8.0 * t)[12:], "y": 0.0, "yaw": 0.0, "speed": 8.0, "kind": Kind.TRUCK}),
        9: (step[:20], {"x": 0.0, "y": (-40.0 + 4.0 * t)[:20], "yaw": 0.5 * np.pi, "speed": 4.0, "kind": Kind.BICYCLE}),
        11: (step, {"x": -30.0 - 1.2 * t, "y": 6.0, "yaw": np.pi, "speed": 1.2, "kind": Kind.PEDESTRIAN}),
    }
    usual = {"kind": Kind.CAR, "length": 4.6, "width": 1.9, "acceleration": 0.0, "lane": -1}
    sizes = {8: {"length": 11.25, "width": 2.5}, 11: {"length": 0.5, "width": 0.5}}
    rows = [
        pd.DataFrame({"vehicle_id": name, "frame": FIRST + steps, **usual, **sizes.get(name, {}), **values})
        for name, (steps, values) in agents.items()
    ]
    table = pd.concat(rows).sort_values(["frame", "vehicle_id"], ignore_index=True).astype({"kind": np.uint8})
    return Content("made", Path("made.parquet"), table, net, 3, FIRST + 5, source="by hand", licence="CC0")


def read_back(path: Path) -> pd.DataFrame:
    """The tracks of a file that `data import` reads, sorted."""
    return load_recording(path).table.sort_values(["frame", "vehicle_id"], ignore_index=True)


def assert_same(read: pd.DataFrame, written: pd.DataFrame, atol: float) -> None:
    assert len(read) == len(written)
    for name in ("frame", "kind"):
        assert (read[name] == written[name].to_numpy() - (FIRST if name == "frame" else 0)).all(), name
    for name in ("x", "y", "speed", "length", "width"):
        np.testing.assert_allclose(read[name], written[name], atol=atol, err_msg=name)
    np.testing.assert_allclose(np.exp(1j * read["yaw"]), np.exp(1j * written["yaw"]), atol=atol)


def test_fcd_output_comes_back_as_it_was(crossing: Path, tmp_path: Path) -> None:
    written = content(crossing)
    out = tmp_path / "made.fcd.xml"
    assert SumoTrajectories().write(written, out)[0] == "128 rows of 4 agents"
    assert_same(read_back(out), written.motion(), 2e-6)
    assert (tmp_path / "made.net.xml").read_bytes() == crossing.read_bytes()
    (truck,) = ET.parse(out).findall("timestep[@time='1.20']/vehicle[@id='8']")
    assert truck.get("x") == f"{30.0 + 8.0 * 1.2 + 0.5 * 11.25:.6f}", "SUMO's positions are front centres"
    assert truck.get("lane") == "e2_0" and float(truck.get("pos", "")) == pytest.approx(35.225)
    assert len(ET.parse(out).findall("timestep/person")) == 40


def test_trajectories_of_openscenario_come_back_to_a_millimetre(crossing: Path, tmp_path: Path) -> None:
    written = content(crossing)
    out = tmp_path / "made.xosc"
    OpenScenario().write(written, out)
    read = read_back(out)
    numbers = {"Ego": 3, "agent_8": 8, "agent_9": 9, "agent_11": 11}
    ids = load_recording(out).header.notes["ids"]
    renamed = read["vehicle_id"].map({number: numbers[name] for name, number in ids.items()})  # type: ignore[attr-defined]
    read = read.assign(vehicle_id=renamed).sort_values(["frame", "vehicle_id"], ignore_index=True)
    inner = read["speed"].between(0.0, 90.0)  # speeds are derived
    assert inner.all()
    assert_same(read.assign(speed=written.motion()["speed"]), written.motion(), 1e-3)
    assert np.abs(read["speed"] - written.motion()["speed"]).max() < 0.05
    import_opendrive(tmp_path / "made.xodr", tmp_path / "back.net.xml")
    assert LaneMap.from_net(tmp_path / "back.net.xml").inside_road(np.array([-100.0, 0.0]), np.array([1.7, 90.0])).all()


def lit(net: Path) -> Content:
    """On a net with lights, of which all are red for a second, green for one and a half, then amber, then red."""
    links = read_links(net)
    groups = tuple(sorted({link.name for link in links}))
    states = np.full((len(groups), 40), int(SignalState.RED), np.uint8)
    states[:, 10:25], states[:, 25:30] = int(SignalState.GREEN), int(SignalState.AMBER)
    states[::2] = states[::2, ::-1]
    known = Signals(groups, links, np.array([groups.index(link.name) for link in links]), states)
    return replace(content(net), signals=known)


def test_lights_of_openscenario_are_those_of_its_opendrive(tmp_path: Path) -> None:
    written = lit(packaged("nets/urban_like.net.xml"))
    known = written.signals
    assert known is not None
    OpenScenario().write(written, tmp_path / "made.xosc")
    road, root = (ET.parse(tmp_path / f"made.{ending}").getroot() for ending in ("xodr", "xosc"))
    lamps = {SignalState.RED: "on;off;off", SignalState.GREEN: "off;off;on", SignalState.AMBER: "off;on;off"}
    group_of = {f"{link.light}_{link.index}": group for link, group in zip(known.links, known.link_group, strict=True)}
    assert {signal.get("id") for signal in road.iter("signal")} == {*group_of}
    shown: dict[str, list[str]] = {
        action.get("name", ""): [action.get("state", "")] * known.states.shape[1]
        for action in root.findall("Storyboard/Init/Actions//TrafficSignalStateAction")
    }
    for event in root.findall("Storyboard/Story//Event"):
        begin = round(10.0 * float(event.find("StartTrigger//SimulationTimeCondition").get("value")))  # type: ignore[union-attr]
        for action in event.iter("TrafficSignalStateAction"):
            states = shown[action.get("name", "")]
            states[begin:] = [action.get("state", "")] * (len(states) - begin)
    assert shown == {
        name: [lamps[SignalState(state)] for state in known.states[group]] for name, group in group_of.items()
    }


@pytest.mark.parametrize("net", ["crossing", "urban_like"])
def test_openscenario_satisfies_the_checker_of_asam(net: str, crossing: Path, tmp_path: Path) -> None:
    pytest.importorskip("qc_openscenario")
    out = tmp_path / "made.xosc"
    OpenScenario().write(content(crossing) if net == "crossing" else lit(packaged(f"nets/{net}.net.xml")), out)
    result = checked(out, tmp_path)
    assert Counter(one.get("status") for one in result.iter("Checker")) == {"completed": 17}
    assert not list(result.iter("Issue"))
    text = out.read_text()
    out.write_text(text.replace('entityRef="Ego"', 'entityRef="nobody"'))
    assert list(checked(out, tmp_path).iter("Issue"))


def checked(path: Path, folder: Path) -> ET.Element:
    """The result of ASAM's checker, by its command line."""
    config, result = folder / "config.xml", folder / "result.xqar"
    bundle = f'<CheckerBundle application="xoscBundle"><Param name="resultFile" value="{result}"/></CheckerBundle>'
    config.write_text(f'<Config><Param name="InputFile" value="{path}"/>{bundle}</Config>')
    subprocess.run([sys.executable, "-m", "qc_openscenario.main", "-c", str(config)], check=True, capture_output=True)
    return ET.parse(result).getroot()


def test_commonroad_comes_back_with_the_ego_as_planning_problem(crossing: Path, tmp_path: Path) -> None:
    written = content(crossing)
    out = tmp_path / "made.xml"
    assert CommonRoad().write(written, out)[0] == "113 rows of 4 agents"
    others = written.motion().query(f"vehicle_id != 3 and frame >= {FIRST + 5}")
    assert_same(read_back(out), others.assign(frame=others["frame"] - 5), 2e-6)
    assert_same(read_back(everything(written, out)), written.motion(), 2e-6)
    ego = written.motion().query(f"vehicle_id == 3 and frame == {FIRST + 5}").iloc[0]
    CommonRoad().write(written, out)
    (state,) = ET.parse(out).findall("planningProblem/initialState")
    assert float(state.findtext("position/point/x", "")) == pytest.approx(ego["x"], abs=1e-6)
    assert state.findtext("time/exact") == "0" and ET.parse(out).findtext(".//goalState/time/intervalEnd") == "34"


def everything(written: Content, out: Path) -> Path:
    """A file with the whole recording, without an ego."""
    CommonRoad().write(replace(written, ego=None, free_from=FIRST), out)
    return out


def test_lanes_and_lights_of_commonroad_come_back(tmp_path: Path) -> None:
    net = packaged("nets/urban_like.net.xml")
    written = lit(net)
    links = read_links(net)
    CommonRoad().write(written, tmp_path / "made.xml")
    source = source_of(tmp_path / "made.xml")
    assert source is not None
    scene = next(source.read(tmp_path / "made.xml", None))
    graph = scene.lanes()
    assert isinstance(graph, LaneGraph)
    lane_map = LaneMap.from_net(net)
    assert len(graph.by_id) == len(lane_map.lanes)
    inside = [lanelet for lanelet in graph.by_id.values() if lanelet.junction]
    assert len(inside) == sum(lane.is_internal for lane in lane_map.lanes)
    built = write_graph(graph, tmp_path / "back.net.xml")
    back = LaneMap.from_net(tmp_path / "back.net.xml")
    for lane in lane_map.lanes:
        along = np.gradient(lane.centerline, axis=0)
        at = back.nearest(*lane.centerline[1:-1].T, np.arctan2(along[1:-1, 1], along[1:-1, 0]))
        assert np.abs(at.d).max(initial=0.0) < 0.02 or lane.is_internal
    held = built.controlled(graph)
    assert sum(map(len, held.values())) == len(links), "every connection has its light again"
    shown = {light: [change for change in scene.signals if change[1] == light] for light in held}
    first = {light: changes[0][2] for light, changes in shown.items()}
    assert set(first.values()) == {"red", "yellow"} or set(first.values()) == {"red"}
    begins = sorted({round(time, 1) for time, _, state in scene.signals if state == "green"})
    assert begins[0] in (0.5, 1.0) and len(begins) == 2


@pytest.mark.skipif(not COMMONROAD.is_file(), reason="make it: examples/commonroad_planner/setup.sh")
def test_commonroad_io_reads_it(crossing: Path, tmp_path: Path) -> None:
    written = content(crossing)
    CommonRoad().write(written, tmp_path / "made.xml")
    early = written.motion().query("vehicle_id != 8")
    CommonRoad().write(replace(written, table=early), tmp_path / "early.xml")
    program = (
        "import sys, commonroad; from commonroad.common.file_reader import CommonRoadFileReader as R\n"
        "from lxml import etree; from pathlib import Path; root = Path(commonroad.__path__[0])\n"
        "schema = etree.XMLSchema(etree.parse(str(next(root.rglob('XML_commonRoad_XSD.xsd')))))\n"
        "schema.assertValid(etree.parse(sys.argv[2]))\n"
        "s, p = R(sys.argv[1]).open(); n = s.lanelet_network\n"
        "o = s.obstacle_by_id(min(one.obstacle_id for one in s.dynamic_obstacles))\n"
        "print(len(n.lanelets), len(n.intersections), len(s.dynamic_obstacles), len(p.planning_problem_dict),\n"
        "      o.obstacle_shape.length, o.initial_state.time_step, o.prediction.final_time_step)"
    )
    done = subprocess.run(
        [COMMONROAD, "-c", program, tmp_path / "made.xml", tmp_path / "early.xml"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["6", "1", "3", "1", "11.25", "7", "34"], done.stderr


@pytest.mark.parametrize("left_hand", [False, True])
def test_opendrive_has_the_lanes_and_the_side_of_the_net(left_hand: bool, tmp_path: Path) -> None:
    y = 1.75 if left_hand else -1.75
    lines = (np.array([[0.0, y], [100.0, y]]), np.array([[100.0, -y], [0.0, -y]]))
    net, out = tmp_path / "two_way.net.xml", tmp_path / "two_way.xodr"
    write_graph(LaneGraph(tuple(Lanelet(f"l{at}", *around(line)) for at, line in enumerate(lines))), net)
    OpenDrive().write(Content("two_way", net, net=net), out)
    assert (' rule="LHT"' in out.read_text()) == left_hand and " date=" not in out.read_text()
    import_opendrive(out, tmp_path / "back.net.xml")
    assert is_left_hand(tmp_path / "back.net.xml") == left_hand
    ends = sorted(lane.centerline[[0, -1]].tolist() for lane in LaneMap.from_net(tmp_path / "back.net.xml").lanes)
    np.testing.assert_allclose(ends, lines, atol=2e-3)


def test_a_scenario_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["export", "demo", str(tmp_path / "demo.fcd.xml")])
    assert "demo.fcd.xml: 23091 rows of 156 agents\nbeside it: demo.types.xml, demo.net.xml" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["urban_like", "out.xosc"], "urban_like.net.xml: is a net, expected a run, a scenario or a recording"),
        (["demo", "out.xlsx"], "out.xlsx: expected a name with the ending of a format: .fcd.xml: SUMO's"),
        (["absent.net.xml", "out.osm"], "absent.net.xml: no such net"),
        (["absent", "out.xml"], "absent: no such recording"),
        (["alone.parquet", "out.xml"], "alone.parquet: its net is not known: name it by --net"),
        (["alone.parquet", "out.xml", "--net", "nowhere"], "no net nowhere"),
        (["demo", "out.xml", "--net", "us101"], "demo: --net names the net of a recording, which this is not"),
    ],
)
def test_what_cannot_be_exported(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    recording = load_recording(packaged("scenarios/us101_like.parquet"))
    type(recording)(replace(recording.header, net=""), recording.columns).write(tmp_path / "alone.parquet")
    assert message in refusal(capsys, main, "export", *arguments)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["alone.parquet"]


def test_the_longest_ending_decides() -> None:
    assert isinstance(format_of(Path("a.fcd.xml")), SumoTrajectories)
    assert isinstance(format_of(Path("a.xml")), CommonRoad)
