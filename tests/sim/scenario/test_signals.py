"""Signals of a scenario: three ways to write them, one meaning; what cannot be right is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from litsim_sim.core.errors import InputError
from litsim_sim.core.signals import SignalState
from litsim_sim.io.yaml_input import load_yaml
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.scenario.signals import Signals, SignalsFile, count_passages, on_clock, read_signals, resolved

GROUPS = {"east": ["WA_0", "WA_1 -> AB_1"], "left": ["WA_2 -> AAN_0"], "walk": []}
CHANGES = [
    [-5.0, "east", "green"],
    [0.0, "left", "red"],
    [2.0, "east", "amber"],
    [3.05, "east", "red"],
    [4.0, "left", "green"],
]


def traffic(count: int = 4) -> Recording:
    """Cars one behind the other on WA_1, the first at the line after 0.5 s; 6 s at 10 m/s."""
    frame = np.arange(20, 81)
    cars = []
    for number in range(1, count + 1):
        front = -114.6 + 10.0 * (0.1 * (frame - 20) - 0.5) - 8.0 * (number - 1)
        cars.append(pd.DataFrame({"vehicle_id": number, "frame": frame, "x": front - 2.0, "y": -4.95}))
    same = {"yaw": 0.0, "speed": 10.0, "acceleration": 0.0, "length": 4.0, "width": 1.8, "kind": 0, "lane": -1}
    return Recording.from_table(RecordingHeader("made"), pd.concat(cars).assign(**same), "made")


@pytest.fixture
def build(tmp_path: Path) -> Callable[..., Scenario]:
    def run(signals: Any, recording: Recording | None = None) -> Scenario:
        (recording or traffic()).write(tmp_path / "made.parquet")
        fields = {"name": "made", "recording": "made.parquet", "net": "urban_like", "ego": 1, "history_s": 1.0}
        (tmp_path / "made.yaml").write_text(yaml.safe_dump(fields | ({} if signals is None else {"signals": signals})))
        return Scenario.load(tmp_path / "made.yaml")

    return run


def shown(signals: Signals | None, group: str) -> list[tuple[int, str]]:
    """Step and name of every change of a group."""
    assert signals is not None
    row = signals.states[signals.groups.index(group)].tolist()
    return [(k, SignalState(row[k]).name) for k in range(len(row)) if k == 0 or row[k] != row[k - 1]]


def test_changes_count_from_frame_0_of_the_recording(build: Callable[..., Scenario]) -> None:
    signals = build({"groups": GROUPS, "changes": CHANGES}).signals
    assert signals is not None
    assert signals.groups == ("east", "left")  # a group without connections is not there
    assert signals.link_names == ("WA_0 -> AAS_0", "WA_0 -> AB_0", "WA_1 -> AB_1", "WA_2 -> AAN_0")
    assert signals.link_group.tolist() == [0, 0, 0, 1]
    assert shown(signals, "east") == [(0, "AMBER"), (11, "RED")]  # the scenario begins at frame 20, 2.0 s
    assert shown(signals, "left") == [(0, "RED"), (20, "GREEN")]
    assert signals.table(11).state.tolist() == [SignalState.RED] * 2
    assert signals.table(1000).state.tolist() == signals.table(60).state.tolist()


def test_a_group_may_name_all_lanes_of_an_edge(build: Callable[..., Scenario]) -> None:
    signals = build({"groups": {"all": ["WA"]}, "changes": [[0.0, "all", "green"]]}).signals
    assert signals is not None
    assert signals.link_names == ("WA_0 -> AAS_0", "WA_0 -> AB_0", "WA_1 -> AB_1", "WA_2 -> AAN_0")


@pytest.mark.parametrize(
    "shown_by",
    [
        {"changes": [[100.0, "east", "green"], [103.0, "east", "red"]]},
        {
            "program": {
                "offset_s": 100.0,
                "phases": [{"duration_s": 3, "states": {"east": "green"}}, {"duration_s": 90}],
            }
        },
    ],
)
def test_times_may_be_of_another_clock(build: Callable[..., Scenario], shown_by: dict[str, Any]) -> None:
    given = SignalsFile.model_validate({"groups": {"east": ["WA"]}} | shown_by)
    signals = build(on_clock(given, 98.0).model_dump(mode="json", exclude_none=True)).signals
    assert shown(signals, "east")[-1] == (30, "RED")  # 103 s there are 5 s here; the scenario begins at 2 s


def test_numbers_are_names() -> None:
    file = load_yaml("{groups: {1: [101, 102_0], 2: []}, states: {file: a.csv, codes: {0: red, 1: green}}}", "here")
    given = SignalsFile.model_validate(file)
    assert given.groups == {"1": ["101", "102_0"], "2": []}
    assert given.states is not None and given.states.codes == {"0": "red", "1": "green"}


def test_how_vehicles_heed_signals(build: Callable[..., Scenario]) -> None:
    changes = [[0.0, "east", "green"], [3.05, "east", "red"]]
    scenario = build({"groups": {"east": ["WA"]}, "changes": changes})
    assert scenario.signals is not None
    assert count_passages(scenario.signals, scenario.log) == {"east": (4, 3)}


def test_before_its_first_change_nothing_is_known_of_a_group(build: Callable[..., Scenario]) -> None:
    signals = build({"groups": GROUPS, "changes": [[3.0, "east", "green"]]}).signals
    assert shown(signals, "east") == [(0, "UNAVAILABLE"), (10, "GREEN")]
    assert shown(signals, "left") == [(0, "UNAVAILABLE")]


def test_signals_of_another_time_are_refused(build: Callable[..., Scenario]) -> None:
    """They would show nothing, and nobody could run a red light."""
    said = r"no group shows anything from 2 to 8 s, counted from frame 0, and the first change is at 3000 s: are unit"
    with pytest.raises(InputError, match=said):
        build({"groups": GROUPS, "changes": [[3000.0, "east", "green"], [3010.0, "east", "red"]]})


def test_a_column_for_each_group(tmp_path: Path, build: Callable[..., Scenario]) -> None:
    rows = {0.0: ("green", "red"), 3.0: ("amber", "red"), 5.0: ("red", "green")}
    table = pd.DataFrame(
        [(1000.0 * t, *states) for t, states in rows.items()], columns=["timestamp(ms)", "east", "left"]
    )
    table.to_csv(tmp_path / "lights.csv", index=False)
    states = {"file": str(tmp_path / "lights.csv"), "begin": "timestamp(ms)", "unit": "ms", "group": ["east", "left"]}
    changes = [
        [t, group, state] for t, both in rows.items() for group, state in zip(("east", "left"), both, strict=True)
    ]
    of_file, wanted = (
        build({"groups": GROUPS} | given).signals for given in ({"states": states}, {"changes": changes})
    )
    assert of_file is not None and wanted is not None
    np.testing.assert_array_equal(of_file.states, wanted.states)
    table.assign(left=["red", None, "green"]).to_csv(tmp_path / "lights.csv", index=False)
    with pytest.raises(InputError, match=r"lights.csv: line 3: column 'left' is empty"):
        build({"groups": GROUPS, "states": states})


@pytest.mark.parametrize("name", ["states.csv", "states.parquet"])
def test_a_file_of_changes_with_codes_of_its_own(tmp_path: Path, build: Callable[..., Scenario], name: str) -> None:
    codes = {"green": 1, "red": 0, "amber": 3}
    table = pd.DataFrame(
        [(group, round(1000 * begin), codes[state]) for begin, group, state in CHANGES],
        columns=["head", "ms", "colour"],
    ).sample(frac=1.0, random_state=3)
    if name.endswith("csv"):
        table.to_csv(tmp_path / name, index=False)
    else:
        table.to_parquet(tmp_path / name)
    states = {"file": name, "group": "head", "begin": "ms", "state": "colour", "unit": "ms"}
    states["codes"] = {str(code): colour for colour, code in codes.items()}  # type: ignore[assignment]
    given = {"groups": GROUPS, "states": states}
    (tmp_path / "signals.yaml").write_text(yaml.safe_dump(given))
    wanted = build({"groups": GROUPS, "changes": CHANGES})
    for way in ("signals.yaml", given):
        scenario = build(way)
        assert scenario.signals is not None and wanted.signals is not None
        np.testing.assert_array_equal(scenario.signals.states, wanted.signals.states)
        again = Scenario.from_yaml(scenario.to_yaml(), "text")  # stands for itself: the file is not needed again
        assert again.signals is not None
        np.testing.assert_array_equal(again.signals.states, wanted.signals.states)


def test_changes_at_dates(tmp_path: Path) -> None:
    (tmp_path / "states.csv").write_text("group,begin,state\neast,2024-05-17T08:30:00.5,red\n")
    given = SignalsFile.model_validate({"groups": {"east": ["WA"]}, "states": {"file": "states.csv"}})
    assert resolved(given, tmp_path, "made").changes == [(1715934600.5, "east", "red")]


@pytest.mark.parametrize(("unit", "begin"), [("ms", 1500), ("us", 1500000), ("ns", 1500000000), ("frame", 15)])
def test_units_of_changes(tmp_path: Path, unit: str, begin: int) -> None:
    (tmp_path / "states.csv").write_text(f"group,begin,state\neast,{begin},red\n")
    given = SignalsFile.model_validate({"groups": {"east": ["WA"]}, "states": {"file": "states.csv", "unit": unit}})
    assert resolved(given, tmp_path, "made").changes == [(1.5, "east", "red")]


def test_a_fixed_cycle(build: Callable[..., Scenario]) -> None:
    phases = [
        {"duration_s": 1.5, "states": {"east": "green"}},
        {"duration_s": 0.5, "states": {"east": "amber"}},
        {"duration_s": 2.0, "states": {"left": "green"}},
    ]
    signals = build({"groups": GROUPS, "program": {"offset_s": 1.0, "phases": phases}}).signals
    # a cycle of 4 s from 1.0 s on; the scenario begins at 2.0 s
    assert shown(signals, "east") == [
        (0, "GREEN"),
        (5, "AMBER"),
        (10, "RED"),
        (30, "GREEN"),
        (45, "AMBER"),
        (50, "RED"),
    ]
    assert shown(signals, "left") == [(0, "RED"), (10, "GREEN"), (30, "RED"), (50, "GREEN")]


def test_a_recording_may_carry_its_signals(build: Callable[..., Scenario], caplog: pytest.LogCaptureFixture) -> None:
    plain = traffic()
    header = RecordingHeader("made", net="urban_like.net.xml", signals={"groups": GROUPS, "changes": CHANGES})
    carried = build(None, Recording.of_table(header, plain.table))
    assert shown(carried.signals, "east") == [(0, "AMBER"), (11, "RED")]
    assert build(None, plain).signals is None
    other = build({"groups": GROUPS, "changes": [[0.0, "east", "green"]]}, Recording.of_table(header, plain.table))
    assert shown(other.signals, "east") == [(0, "GREEN")]
    elsewhere = RecordingHeader("made", net="other.net.xml", signals=header.signals)
    for _ in range(2):
        assert build(None, Recording.of_table(elsewhere, plain.table)).signals is None
    (said,) = caplog.messages
    assert "made.parquet: carries signals of net other.net.xml, which are left out on urban_like.net.xml" in said


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ({"groups": GROUPS}, "expected one of changes, states and program, found none"),
        ({"groups": GROUPS, "changes": [], "program": {"phases": [{"duration_s": 1}]}}, "found changes and program"),
        ({"groups": {}, "changes": []}, "groups: Dictionary should have at least 1 item"),
        ({"groups": {"a": ["WA_7"]}, "changes": []}, r"signals, field groups\.a: WA_7: the net has no .*; near: WA_"),
        ({"groups": {"a": ["lane7"]}, "changes": []}, r"a: lane7: the net has no such .*; near: AB, ANA, .*, WA$"),
        ({"groups": {"a": ["WA_0"], "b": ["WA_0 -> AB_0"]}, "changes": []}, "WA_0 -> AB_0 is in groups a and b"),
        ({"groups": {"a": []}, "changes": []}, "no group controls a connection"),
        ({"groups": GROUPS, "changes": [[0.0, "west", "red"]]}, "group west is not among groups, east, left"),
        ({"groups": GROUPS, "changes": [[0.0, "east", "blue"]]}, r"line 10, field signals.changes.0.2"),
        ({"groups": GROUPS, "changes": [[1.0, "east", "red"], [0.0, "east", "red"]]}, "0 s after 1 s, not ascending"),
        (
            {"groups": GROUPS, "program": {"phases": [{"duration_s": 0}]}},
            "duration_s: Input should be greater than or equal to 0.1",
        ),
        (
            {"groups": GROUPS, "changes": [[np.nan, "east", "red"]]},
            "field signals.changes.0.0: Input should be a finite",
        ),
        (
            {"groups": GROUPS, "changes": [[0.0, "east", "red"], [0.0, "east", "green"]]},
            "changes: group east shows red and green at 0 s, expected one",
        ),
        (
            {"groups": GROUPS, "program": {"phases": [{"duration_s": 1, "states": {"x": "red"}}]}},
            "group x is not among",
        ),
        ("absent.yaml", "absent.yaml: no such file"),
    ],
)
def test_what_cannot_be_used(build: Callable[..., Scenario], signals: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        build(signals)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("group,begin,state\neast,zero,red\n", r"states\.csv: line 2: column 'begin' is 'zero', expected a number"),
        (
            "group,begin,state\neast,0,red\neast,1,7\n",
            r"states\.csv: line 3: state '7' is none of .*; say in",
        ),
        (
            "group,begin,state\nwest,0,red\n",
            r"group west of states\.csv is missing; one that is not",
        ),
        ("group,begin\nwest,0\n", r"columns \['state'\] are missing; the file has \['group', 'begin'\]"),
        ("", "not readable as CSV or Parquet"),
        ("group,begin,state\neast,0,red\n,1,red\n", r"states\.csv: line 3: column 'group' is empty"),
        ("group,begin,state\neast,0,\n", r"states\.csv: line 2: column 'state' is empty"),
        (
            "group,begin,state\neast,1,red\neast,0,red\neast,1,amber\n",
            r"line 2, red; .*states\.csv: line 4, amber: group east shows two states at one time, expected one",
        ),
    ],
)
def test_files_that_cannot_be_used(tmp_path: Path, build: Callable[..., Scenario], text: str, message: str) -> None:
    (tmp_path / "states.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        build({"groups": GROUPS, "states": {"file": "states.csv"}})
    (tmp_path / "states.csv").unlink()
    with pytest.raises(InputError, match=r"states\.csv: no such file of signal states"):
        build({"groups": GROUPS, "states": {"file": "states.csv"}})


def test_a_light_that_is_off_needs_no_quotes(tmp_path: Path) -> None:
    (tmp_path / "signals.yaml").write_text("groups: {east: [WA_0]}\nchanges: [[0, east, off], [1, east, red]]\n")
    assert read_signals(tmp_path / "signals.yaml").changes == [(0.0, "east", "off"), (1.0, "east", "red")]


def test_signals_that_nobody_heeds_are_refused(build: Callable[..., Scenario]) -> None:
    with pytest.raises(
        InputError, match=r"group east: 6 of 6 vehicles pass its stop lines at red: are its connections"
    ):
        build({"groups": GROUPS, "changes": [[0.0, "east", "red"]]}, traffic(6))
    half = [[0.0, "east", "red"], [4.6, "east", "green"]]
    assert build({"groups": GROUPS, "changes": half}, traffic(6)).signals
