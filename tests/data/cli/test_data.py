"""The commands of `data`: converting, looking, drawing, exporting."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from command_line import refusal
from litsim_data import cli as data
from litsim_data.exports import reading
from litsim_data.exports import table as export
from litsim_data.ngsim.sites import I80
from litsim_sim.core.scene import Controller
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.run import Run, RunInfo
from litsim_sim.scenario.recording import COLUMNS, Recording
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import Signals
from made_ngsim import table, write_portal, write_text

EMBEDDED = packaged("scenarios/us101_like.parquet")
STREET = packaged("suites/small/street_14.parquet", "litsim_eval")


@pytest.fixture(scope="module")
def portal_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_portal(pd.concat([table(), table(I80, "1600")]), tmp_path_factory.mktemp("portal") / "portal.csv")


# Convert and info


COLUMNS_OF_CARS = {"vehicle_id": "id", "frame": "n", "x": "x", "y": "y", "length": 4, "width": 2}


def mapping_at(path: Path, **fields: object) -> Path:
    made = {"name": "made", "columns": COLUMNS_OF_CARS, "reference": "box_centre"}
    path.write_text(yaml.safe_dump(made | fields, sort_keys=False))
    return path


def test_convert_and_info_of_official_files(
    portal_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data.main(["info", str(portal_file)])
    said = capsys.readouterr().out
    assert said.count("2000 read, 2000 used") == 2 and "us101_0750" in said and "i80_1600" in said
    data.main(["convert", str(portal_file), str(tmp_path / "out")])
    said = capsys.readouterr().out
    assert "i80_1600" in said and "2000 read, 2000 used, 2000 at 10 Hz" in said
    data.main(["info", str(tmp_path / "out" / "i80_1600.parquet")])
    assert "i80.net.xml" in capsys.readouterr().out
    data.main(["convert", str(portal_file), str(tmp_path / "cut"), "--raw", "--crop", "local_y", "100", "200"])
    capsys.readouterr()
    assert Recording.read(tmp_path / "cut" / "us101_0750.parquet").table["x"].between(90.0, 200.0).all()


def test_convert_with_a_mapping(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "in.csv"
    pd.DataFrame({"id": "a", "n": range(20), "x": np.arange(20) * 1.0, "y": 0.0}).to_csv(source, index=False)
    mapping = mapping_at(tmp_path / "m.yaml")
    data.main(["convert", str(source), str(tmp_path / "out.parquet"), "--mapping", str(mapping)])
    assert "0 to 19 (1.9 s at 10 Hz), 20 rows" in capsys.readouterr().out
    assert len(Recording.read(tmp_path / "out.parquet").table) == 20
    before = source.read_bytes(), mapping.read_bytes()
    for given, out in ((source, source), (source, mapping)):
        assert f"{out}: is the input {out} itself, expected another file" in refusal(
            capsys, data.main, "convert", given, out, "--mapping", mapping
        )
    assert (source.read_bytes(), mapping.read_bytes()) == before


def test_noisy_motion_is_kept_by_raw_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x = np.arange(80) + np.random.default_rng(0).normal(0.0, 0.1, 80)
    pd.DataFrame({"id": "a", "n": range(80), "x": x, "y": 0.0}).to_csv(tmp_path / "in.csv", index=False)
    mapping = mapping_at(tmp_path / "m.yaml")
    command = ["convert", str(tmp_path / "in.csv"), str(tmp_path / "out.parquet"), "--mapping", str(mapping)]
    for options, cleaned in (([], True), (["--raw"], False)):
        data.main([*command, *options])
        assert ("noisy      cleaned: accelerations beyond" in capsys.readouterr().out) == cleaned
        found = Recording.read(tmp_path / "out.parquet").table["x"]
        assert (np.abs(found - x).max() < 1e-6) != cleaned


def test_one_mapping_for_several_recordings_with_vehicles_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicles = {"file": "01_meta.csv", "vehicle_id": "id"}
    mapping = mapping_at(tmp_path / "m.yaml", columns=COLUMNS_OF_CARS | {"length": "long"}, vehicles=vehicles)
    plain = mapping_at(tmp_path / "plain.yaml")
    for number in (1, 2):
        track = pd.DataFrame({"id": 7, "n": range(20), "x": np.arange(20) * 1.0, "y": 0.0})
        track.to_csv(tmp_path / f"0{number}_tracks.csv", index=False)
        (tmp_path / f"0{number}_meta.csv").write_text(f"id,long\n7,{3 + number}\n")
    command = ["convert", str(tmp_path / "02_tracks.csv"), str(tmp_path / "out.parquet")]
    second = ["--vehicles", str(tmp_path / "02_meta.csv")]
    for options, length in (([], 4.0), (second, 5.0)):
        data.main([*command, "--mapping", str(mapping), *options])
        recording = Recording.read(tmp_path / "out.parquet")
        assert set(recording.table["length"]) == {length}
        assert str(tmp_path) not in str(recording.header.notes)
    capsys.readouterr()
    for options, said in (([], "--vehicles goes with --mapping"), (["--mapping", str(plain)], "field")):
        assert said in refusal(capsys, data.main, *command, *options, *second)


def test_frames_of_signals_are_those_of_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At 25 Hz, frame 50 is second 2."""
    cars = [
        pd.DataFrame({"id": number, "n": 25 * number + np.arange(75), "x": -126.6 + 0.4 * np.arange(75), "y": -4.95})
        for number in range(6)
    ]
    pd.concat(cars).to_csv(tmp_path / "in.csv", index=False)
    mapping = mapping_at(tmp_path / "m.yaml", rate_hz=25, signals="signals.yaml", net="urban_like.net.xml")
    states = {"file": "states.csv", "unit": "frame"}
    (tmp_path / "signals.yaml").write_text(yaml.safe_dump({"groups": {"east": ["WA"]}, "states": states}))
    (tmp_path / "states.csv").write_text("group,begin,state\neast,0,green\neast,50,red\neast,75,green\n")
    data.main(["convert", str(tmp_path / "in.csv"), str(tmp_path / "out.parquet"), "--mapping", str(mapping)])
    carried = Recording.read(tmp_path / "out.parquet").header.signals["changes"]
    assert carried == [[0.0, "east", "green"], [2.0, "east", "red"], [3.0, "east", "green"]]
    assert "east: 6 vehicles pass, 1 at red" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["info", "absent.parquet"], "absent.parquet: no such recording"),
        (["convert", "absent.parquet", "out.parquet"], "absent.parquet: no such recording"),
        (["convert", str(EMBEDDED), "out.parquet", "--crop", "frame", "1", "x"], "expected a column and two numbers"),
        (["convert", str(EMBEDDED), "out.parquet", "--crop", "colour", "1", "2"], "unknown column 'colour'"),
        (["convert", str(EMBEDDED), "/dev/null/out.parquet"], "cannot be written"),
        (["map", "--recording", "absent.parquet", "--out", "out.net.xml"], "absent.parquet: no such recording"),
        (["convert", str(EMBEDDED), "out.parquet", "--mapping", "absent.yaml"], "absent.yaml: no such file"),
        (["clean", "cut.txt", "cut.txt"], "cut.txt: is the input cut.txt itself"),
        (["convert", str(EMBEDDED), "."], ".: exists already, expected a new folder"),
        (["convert", "cut.txt", "more.txt", "out"], "more.txt: no such recording"),
        (
            ["convert", "in.csv", "m.yaml", "--draft", "--vehicles", "meta.csv", "--clip", "3"],
            "without --vehicles, --clip",
        ),
        (["convert", "in.csv", "m.yaml", "--draft", "--mapping", "m2.yaml", "--raw"], "goes without --mapping, --raw"),
        (["convert", "in.csv", "m.yaml", "--draft", "--crop", "x", "0", "1"], "--draft goes without --crop"),
        (
            ["convert", "in.csv", "m.yaml", "--draft", "--vehicles", "v.csv"],
            "--draft goes without --vehicles: it reads IN alone; fields vehicles, clip and rows of the",
        ),
        (["convert", "cut.txt", "out"], "; the file ends within this line"),
        (["info", "cut.txt"], "; the file ends within this line"),
        (["plot", str(EMBEDDED), "out.gif"], "expected a name that ends with .png or .html"),
        (["plot", str(EMBEDDED), "out.png", "--net", "absent.net.xml"], "absent.net.xml"),
        (["plot", str(EMBEDDED), "/dev/null/out.png"], "cannot be written"),
        (["plot", str(EMBEDDED), "out.png", "--at", "1"], "moments are drawn of an intersection"),
        (["plot", str(STREET), "out.png", "--at", "nan"], "argument --at: 'nan', expected a number of at least 0"),
        (["plot", str(STREET), "out.png", "--at", "99"], "moment 99: expected 0 to 20 s"),
        (["plot", str(STREET), "out.png", "--signals", "absent.yaml"], "absent.yaml"),
        (["export", "absent", "out.csv"], "absent"),
    ],
)
def test_errors_take_one_line_and_status_2(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    text = write_text(table(rows_wanted=2), tmp_path / "cut.txt").read_text()
    (tmp_path / "cut.txt").write_text(text[: len(text) - 60])
    said = refusal(capsys, data.main, *arguments).strip().splitlines()
    assert message in said[-1]
    if arguments[0] not in ("map", "info") and "cut.txt" not in arguments:  # those show their progress before
        assert len(said) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["cut.txt"]


def test_tracks_are_cut_to_a_net(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part = Recording.read(EMBEDDED)
    part = Recording.of_table(part.header, part.table[part.table["frame"] < 20])
    shifted = part.table.assign(x=part.table["x"] - 60.0)
    Recording.of_table(part.header, shifted).write(tmp_path / "in.parquet")
    data.main(["convert", str(tmp_path / "in.parquet"), str(tmp_path / "out.parquet"), "--net", "us101_like"])
    cut = Recording.read(tmp_path / "out.parquet").table
    lanes = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    assert 0 < len(cut) < len(shifted) and lanes.inside_road(cut["x"].to_numpy(), cut["y"].to_numpy()).all()
    assert re.search(r"left out   \d+ rows of vehicles before they come onto the map", capsys.readouterr().out)
    far = shifted.assign(y=shifted["y"] + 500.0)
    Recording.of_table(part.header, far).write(tmp_path / "far.parquet")
    arguments = ("convert", tmp_path / "far.parquet", tmp_path / "no.parquet", "--net", "us101_like")
    assert "no vehicle comes onto a lane of" in refusal(capsys, data.main, *arguments)
    assert not (tmp_path / "no.parquet").exists()


# Plot and export


def test_plot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    crop = ["--crop", "frame", "0", "60"]
    data.main(["plot", str(EMBEDDED), str(tmp_path / "out.png"), *crop])
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")
    data.main(["plot", str(EMBEDDED), str(tmp_path / "out.html"), *crop, "--net", "us101_like"])
    page = (tmp_path / "out.html").read_text()
    assert page.count("data:image/png;base64,") == 1
    assert not re.search(r'(src|href)="(?!data:)', page)  # needs no other file
    assert "us101_like" in page


def test_plot_finds_the_net_that_the_header_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from litsim_data.pictures import recording_plots

    lanes: list[int] = []
    monkeypatch.setattr(recording_plots, "draw", lambda *given: lanes.append(bool(given[3])))
    part = Recording.read(EMBEDDED)
    part = Recording.of_table(part.header, part.table[part.table["frame"] < 20])
    for net in ("own.net.xml", "own", "us101_like.net.xml", "absent.net.xml"):
        Recording.of_table(replace(part.header, net=net), part.table).write(tmp_path / "part.parquet")
        shutil.copy(packaged("nets/us101_like.net.xml"), tmp_path / "own.net.xml")
        data.main(["plot", str(tmp_path / "part.parquet"), str(tmp_path / "out.png")])
    assert lanes == [True, True, True, False]
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and "drawn without lanes" in said[0] and "absent.net.xml" in said[0]


def test_plot_of_an_intersection_shows_its_signals_at_each_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from litsim_data.pictures import recording_plots

    drawn: list[tuple[tuple[str, ...], int]] = []
    boxes: list[int] = []
    lines, agents = recording_plots.draw_stop_lines, recording_plots.draw_boxes
    monkeypatch.setattr(
        recording_plots, "draw_stop_lines", lambda a, s, k: (drawn.append((s.groups, k)), lines(a, s, k))
    )
    monkeypatch.setattr(recording_plots, "draw_boxes", lambda a, t, c: (boxes.append(len(t.id)), agents(a, t, c)))
    data.main(["plot", str(STREET), str(tmp_path / "out.html"), "--at", "2", "9.5"])
    assert (tmp_path / "out.html").read_text().count("data:image/png;base64,") == 1
    assert [step for _, step in drawn] == [0, 20, 95], "of the first frame with the tracks, and of each moment"
    assert "A0" in drawn[0][0]
    frames = Recording.read(STREET).table["frame"]
    assert boxes == [int((frames == frames.min() + step).sum()) for step in (20, 95)]


def test_plot_shows_the_signals_that_are_named_instead_of_the_recordings_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from litsim_data.pictures import recording_plots
    from litsim_sim.lane_map.signal_links import read_links

    given: list[Signals] = []
    monkeypatch.setattr(recording_plots, "draw", lambda *drawn: given.append(drawn[4]))
    link = read_links(packaged("nets/urban_like.net.xml"))[0].name
    (tmp_path / "mine.yaml").write_text(f"groups: {{mine: ['{link}']}}\nchanges: [[0.0, mine, green]]\n")
    options = [str(tmp_path / "out.png"), "--signals", str(tmp_path / "mine.yaml")]
    data.main(["plot", str(STREET), *options])
    (signals,) = given
    assert signals.groups == ("mine",) and signals.link_names == (link,)
    assert set(signals.states.ravel().tolist()) == {int(SignalState.GREEN)}

    part = Recording.read(STREET)
    Recording.of_table(replace(part.header, net="", signals={}), part.table).write(tmp_path / "netless.parquet")
    assert "signals need a net: name it with --net" in refusal(
        capsys, data.main, "plot", tmp_path / "netless.parquet", *options
    )


def test_plot_says_which_lanes_it_leaves_out(tmp_path: Path, track: type, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from litsim_data.pictures.recording_plots import draw
    from litsim_sim.scenario.recording import RecordingHeader

    titles: list[str] = []
    monkeypatch.setattr(Axes, "set_title", lambda _, title, **__: titles.append(title))
    rows = pd.concat([track(id=k, x=0.0, last=10 + k).rows().assign(lane=k) for k in range(1, 15)])
    recording = Recording.from_table(RecordingHeader("many"), rows, "many")
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: None)  # drawing takes longer than all else
    draw(recording, tmp_path / "many.html", "")
    assert [title for title in titles if "busiest" in title] == ["the 12 busiest of 14 lanes"]
    assert sum(title.startswith("lane ") for title in titles) == 12


def test_plot_of_one_vehicle_without_lane(tmp_path: Path, track: type) -> None:
    from litsim_data.pictures.recording_plots import draw
    from litsim_sim.scenario.recording import RecordingHeader

    for yaw in (0.0, 3.0):
        recording = Recording.from_table(RecordingHeader("one"), track(id=1, x=0.0, yaw=yaw).rows(), "one")
        draw(recording, tmp_path / "one.png", "")


def a_run(agent_table: object, **fields: object) -> Run:
    make = agent_table
    tables = [
        make(step, {"id": 3, "x": 1.0 + step, "controller": Controller.EGO}, {"id": 9, "y": -5.0})  # type: ignore[operator]
        for step in range(4)
    ]
    info = RunInfo("r", "s", "", "idm", "litsim", 3, 0, 3, 1, 0.1, "lockstep", (), (), "", "")
    return Run(Path("r.mcap"), info, tables, scenario_yaml="start_frame: 316\n", **fields)  # type: ignore[arg-type]


def test_export_of_a_run(tmp_path: Path, agent_table: object) -> None:
    content = reading.run_content(a_run(agent_table), tmp_path)
    rows = content.table
    assert rows is not None and content.ego == 3 and content.net is None and content.free_from == 317
    assert list(rows.columns) == [*COLUMNS, "step", "yaw_rate", "controller"]
    assert rows["frame"].tolist() == [316, 316, 317, 317, 318, 318, 319, 319]
    assert rows["controller"].tolist()[:2] == ["ego", "log"]
    assert set(rows["lane"]) == {-1}
    for name in ("out.csv", "out.parquet"):
        assert export.Table().write(content, tmp_path / name) == ["8 rows of 2 agents (4 ego, 4 log)"]
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "out.csv"), rows, check_dtype=False)
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "out.parquet"), rows, check_dtype=False)


def test_exported_lanes_count_from_the_left(agent_table: object) -> None:
    net = packaged("nets/us101_like.net.xml").read_bytes()
    rows = export.trajectories(a_run(agent_table, net_xml=net))
    assert rows.loc[rows["vehicle_id"] == 9, "lane"].tolist() == [2] * 4  # y = -5 m: second from the left


def test_exported_lanes_count_from_the_left_beside_a_footpath(agent_table: object) -> None:
    """SUMO numbers footpaths, too, which are no lanes of cars: the leftmost lane was 0, which stands for none."""
    lane = (
        '<lane id="a_{0}" index="{0}" {1}="pedestrian" speed="13.9" length="300.0" width="3.5" shape="0,{2} 300,{2}"/>'
    )
    lanes = "".join(lane.format(*each) for each in ((0, "allow", -8.5), (1, "disallow", -5.0), (2, "disallow", -1.5)))
    ends = "".join(f'<junction id="{name}" type="dead_end" x="0" y="0" incLanes="" intLanes=""/>' for name in "xy")
    net = f'<net version="1.20"><edge id="a" from="x" to="y" priority="1">{lanes}</edge>{ends}</net>'
    rows = export.trajectories(a_run(agent_table, net_xml=net.encode()))
    assert rows["lane"].tolist() == [1, 2] * 4
