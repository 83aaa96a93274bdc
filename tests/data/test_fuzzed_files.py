"""Files of recordings and maps that somebody has spoilt: a sound recording or map, or one line that names the file."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import made_intersection
import made_openscenario as made
import made_published
import made_sources
from litsim_data.maps.lanelet2_osm import read_graph
from litsim_data.maps.opendrive_lanes import read_lanes
from litsim_data.maps.opendrive_roads import Roads
from litsim_data.sources.openscenario.source import OpenScenario
from litsim_data.sources.scenario_net import ScenarioNet
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import COLUMNS, Recording, RecordingHeader
from made_maps import opendrive, road
from made_ngsim import table, write_portal, write_text

WORDS = (
    "nan",
    "inf",
    "-1e308",
    "1e999",
    "",
    '"',
    '"1,0',
    ",",
    "  ",
    "0x1F",
    "fast",
    "\0",
    "\xff",
    "9" * 40,
    "-0",
    "\n",
)
LINE_WAYS = ["word", "word", "word", "cut", "twice", "left out", "joined", "turned", "anything"]
TABLE_WAYS = ["value", "value", "null", "type", "renamed", "left out", "twice", "rows", "none"]
NUMBERS = [float("nan"), float("inf"), -1e300, 1e300, 0.0, -1.0, 0.5]


def made_text(folder: Path, *, portal: bool) -> str:
    path = folder / "made.txt"
    (write_portal if portal else write_text)(table(rows_wanted=60), path)
    return path.read_text()


TEXTS: dict[str, Callable[[Path], str]] = {
    "text": lambda folder: made_text(folder, portal=False),
    "portal": lambda folder: made_text(folder, portal=True),
} | {write.__name__: (lambda folder, write=write: write(folder).read_text()) for write in made_published.WRITERS}


@pytest.fixture(scope="module")
def texts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return {name: made(tmp_path_factory.mktemp("texts")) for name, made in TEXTS.items()}


@st.composite
def spoilt_text(draw: st.DrawFn, text: str) -> bytes:
    """`text` with a word in place of another, or lines left out, twice, cut, put together, or in another order."""
    lines = text.splitlines()
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(lines) - 1))
        way = draw(st.sampled_from(LINE_WAYS))
        separator = next((mark for mark in ",;" if mark in lines[at]), "  ")
        if way == "word":
            words = lines[at].split(separator)
            words[draw(st.integers(0, len(words) - 1))] = draw(st.sampled_from(WORDS) | st.text(max_size=5))
            lines[at] = separator.join(words)
        elif way == "cut":
            lines[at] = lines[at][: draw(st.integers(0, len(lines[at])))]
        elif way == "twice":
            lines.insert(at, lines[at])
        elif way == "left out" and len(lines) > 1:
            del lines[at]
        elif way == "joined" and at + 1 < len(lines):
            lines[at : at + 2] = [lines[at] + lines[at + 1]]
        elif way == "turned":
            lines.reverse()
        elif way == "anything":
            lines[at] = draw(st.text(max_size=200))
    return ("\n".join(lines) + "\n").encode("latin-1", errors="replace")


def loaded(path: Path) -> Recording | None:
    """The recording of a file, sound; None where it is refused."""
    try:
        recording = load_recording(path)
    except InputError as error:
        said = str(error)
    else:
        numbers = recording.table.select_dtypes("number").to_numpy(np.float64)
        assert len(numbers) and np.isfinite(numbers).all()
        assert not recording.table.duplicated(["vehicle_id", "frame"]).any()
        return recording
    assert said.startswith(str(path)) and "\n" not in said
    return None


@pytest.mark.parametrize("which", TEXTS)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_spoilt_tables_are_refused_or_sound(
    texts: dict[str, str], tmp_path_factory: pytest.TempPathFactory, which: str, data: Any
) -> None:
    path = tmp_path_factory.getbasetemp() / "spoilt.txt"
    path.write_bytes(data.draw(spoilt_text(texts[which])))
    loaded(path)


@pytest.mark.parametrize("which", TEXTS)
def test_the_files_are_sound_before(texts: dict[str, str], tmp_path: Path, which: str) -> None:
    path = tmp_path / "whole.txt"
    path.write_text(texts[which])
    recording = loaded(path)
    assert recording is not None and len(recording.table) > 40


@st.composite
def spoilt_table(draw: st.DrawFn, whole: pa.Table) -> pa.Table:
    """`whole` with a column of another type, of other values, renamed, twice or left out, or with other rows."""
    at = draw(st.integers(0, whole.num_columns - 1))
    name, column = whole.column_names[at], whole.column(at).to_pylist()
    way = draw(st.sampled_from(TABLE_WAYS))
    spoilt = whole.slice(0, 0)
    if way in ("value", "null"):
        column[draw(st.integers(0, len(column) - 1))] = None if way == "null" else draw(st.sampled_from(NUMBERS))
        spoilt = whole.set_column(at, name, pa.array(column))
    elif way == "type":
        kinds: dict[str, Any] = {
            "text": pa.array([str(value) for value in column]),
            "bytes": pa.array([b"\xff"] * len(column)),
            "list": pa.array([[value] for value in column]),
            "time": pa.array([0] * len(column), pa.timestamp("ns")),
            "small": pa.array([value % 100 for value in column]).cast(pa.int8(), safe=False),
            "bool": pa.array([bool(value) for value in column]),
            "nothing": pa.nulls(len(column)),
        }
        spoilt = whole.set_column(at, name, kinds[draw(st.sampled_from(sorted(kinds)))])
    elif way == "renamed":
        spoilt = whole.rename_columns([draw(st.text(max_size=5)) if c == name else c for c in whole.column_names])
    elif way == "left out":
        spoilt = whole.drop_columns([name])
    elif way == "twice":
        spoilt = whole.append_column(name, whole.column(at))
    elif way == "rows":
        rows = draw(st.lists(st.integers(0, whole.num_rows - 1), max_size=30))
        spoilt = whole.take(pa.array(rows, pa.int64()))
    return spoilt


def recording_of(rows: int) -> Recording:
    step = np.arange(rows)
    same = {"yaw": 0.0, "speed": 10.0, "acceleration": 0.0, "length": 4.5, "width": 2.0, "kind": 0, "lane": -1}
    cars = [pd.DataFrame({"vehicle_id": car, "frame": step, "x": step * 1.0, "y": 4.0 * car, **same}) for car in (1, 2)]
    return Recording.from_table(RecordingHeader("made"), pd.concat(cars, ignore_index=True)[list(COLUMNS)], "made")


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_spoilt_pickles_are_refused_or_sound(tmp_path_factory: pytest.TempPathFactory, data: Any) -> None:
    path = made_sources.scenario_net(
        tmp_path_factory.getbasetemp() / "spoilt.pkl", protocol=data.draw(st.integers(2, 5))
    )
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        new = data.draw(st.binary(max_size=3))
        content[at : at + data.draw(st.sampled_from([0, len(new), 40]))] = new
    path.write_bytes(content)
    if ScenarioNet().recognizes(path):
        loaded(path)


@settings(max_examples=80)
@given(data=st.data())
def test_spoilt_parquet_is_refused_or_sound(tmp_path_factory: pytest.TempPathFactory, data: Any) -> None:
    path = tmp_path_factory.getbasetemp() / "spoilt.parquet"
    recording_of(10).write(path)
    whole = pq.read_table(path)
    pq.write_table(data.draw(spoilt_table(whole)).replace_schema_metadata(whole.schema.metadata), path)
    loaded(path)


@st.composite
def spoilt_xml(draw: st.DrawFn, text: str) -> bytes:
    """`text` with other values of attributes, and elements left out, twice or cut."""
    for _ in range(draw(st.integers(1, 3))):
        way = draw(st.sampled_from(["value", "value", "value", "left out", "twice", "cut"]))
        pattern = r'"[^"]*"' if way == "value" else r"<[^<>]*/>|<(\w+)[^<>]*>[^<>]*</\1>|<[^<>]*>"
        places = list(re.finditer(pattern, text)) or list(re.finditer("$", text))
        place = places[draw(st.integers(0, len(places) - 1))]
        word = draw(st.sampled_from([*WORDS, "-1", "0", "1e6", "12", "${1/0}", "$a", "relative"]))
        new = {"value": f'"{word}"', "left out": "", "twice": 2 * place[0]}.get(way, "")
        text = text[: place.start()] + new + text[place.end() :] * (way != "cut")
    return text.encode("latin-1", errors="replace")


def scenario_text(folder: Path) -> str:
    lane = (
        '<LanePosition roadId="1" laneId="-1" s="100" offset="0.1"><Orientation type="relative" h="0"/></LanePosition>'
    )
    beside = '<RelativeLanePosition entityRef="A" dLane="1" ds="20"/>'
    first = made.STAND.format(lane) + made.SPEED.format(shape="linear", lasts="1", speed="4")
    waits = made.when(made.STATE.format("event", "e", "endTransition"), delay=1.0, edge="rising")
    way = made.follow({0.0: made.world(-80.0), 2.0: lane}, more='initialDistanceOffset="1"')
    near = made.when_of("A", '<TimeHeadwayCondition entityRef="B" freespace="true" rule="lessThan" value="3"/>')
    aside = made.CHANGE.format(target='<AbsoluteTargetLane value="1"/>')
    acts = made.act("c", "A", {"g": (aside, made.when(near))}) + made.act(
        "a", "A", {"e": (way, made.when(made.AT.format(1, "greaterThan")))}
    )
    acts += made.act("b", "B", {"f": (made.follow({0.0: made.world(0.0), 3.0: beside}), "")}, waits)
    stop = made.when(made.AT.format(9, "greaterThan"), tag="StopTrigger")
    return made.write(folder, {"A": made.CAR, "B": made.VAN}, {"A": first}, acts, stop).read_text().replace("'", '"')


def map_text(folder: Path) -> str:
    made_intersection.write_map(folder / "made.osm")
    return (folder / "made.osm").read_text()


def tracks_of(path: Path) -> Any:
    (scene,) = OpenScenario().read(path, None)
    table = scene.tracks.table  # type: ignore[attr-defined]
    assert np.isfinite(table.select_dtypes("number").to_numpy()).all() and len(table)


READERS: dict[str, tuple[Callable[[Path], str], Callable[[Path], Any]]] = {
    "made.xosc": (scenario_text, tracks_of),
    "both.xodr": (
        lambda _: opendrive(road(), road(rule=' rule="LHT"')),
        lambda path: read_lanes(path).by_id,
    ),
    "made.xodr": (lambda _: opendrive(), lambda path: Roads(path).place(0.0, -1.75, 0.0)),
    "made.osm": (map_text, lambda path: read_graph(path, (49.0, 8.4)).by_id),
}


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=8, deadline=None)
@given(data=st.data())
def test_spoilt_scenarios_and_maps_are_refused_or_read(
    tmp_path_factory: pytest.TempPathFactory, name: str, data: Any
) -> None:
    if name == "made.osm":
        pytest.importorskip("lanelet2")
    folder = tmp_path_factory.getbasetemp()
    (folder / "made.xodr").write_text(opendrive())
    text, read = READERS[name]
    path = folder / f"spoilt.{name}"
    path.write_bytes(data.draw(spoilt_xml(text(folder))))
    told = ""
    try:
        read(path)
    except InputError as error:
        told = str(error)
    assert "\n" not in told
