"""`data suite`: arguments, table, picture and file."""

import shutil
from functools import partial
from itertools import pairwise
from pathlib import Path

import pandas as pd
import pytest

from campaigns import scenario_file
from command_line import status
from litsim_data import cli as data
from litsim_data.cli.suite import find, parse_events
from litsim_data.mining.events import EventKind
from litsim_eval.campaign.suite import Suite
from litsim_sim.core.errors import EXIT_FAILED, EXIT_INPUT, InputError
from litsim_sim.scenario.scenario import Scenario

called = partial(status, data.main, "suite")


def test_the_demo_gives_a_suite_and_the_same_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, again = tmp_path / "hard.yaml", tmp_path / "again.yaml"
    asked = ("demo", "--events", "lane_change,cut_in=1", "--hardest", "2", "--ego", "idm", "bat")
    assert called(*asked, "--out", out) == 0
    printed = capsys.readouterr().out
    assert "lane change" in printed and "merge" not in printed
    suite = Suite.load(out)
    assert suite.name == "hard"
    assert [ego.kind for ego in suite.egos] == ["idm", "bat"]
    assert sorted(tag for case in suite.cases for tag in case.tags) == ["cut_in", "lane_change", "lane_change"]
    assert all(case.scenario == "demo" for case in suite.cases)
    assert called(*asked, "--name", "hard", "--out", again) == 0
    assert again.read_bytes() == out.read_bytes()


def test_the_hardest_are_at_least_as_hard_as_a_spread(tmp_path: Path) -> None:
    worst = {}
    for how in ("--hardest", "--spread"):
        out = tmp_path / f"{how.strip('-')}.yaml"
        assert called("demo", "--events", "lane_change", how, "3", "--out", out) == 0
        worst[how] = sorted(case.events[0]["severity"] for case in Suite.load(out).cases)
    assert len(worst["--hardest"]) == len(worst["--spread"]) == 3
    assert worst["--hardest"][2] == worst["--spread"][2]
    assert worst["--hardest"][0] > worst["--spread"][0]


def test_an_event_in_two_pieces_of_a_recording_is_of_the_first(tmp_path: Path) -> None:
    first, second = (scenario_file(tmp_path, f"from_{frame}", start_frame=frame) for frame in (0, 10))
    both, alone = find([first, second], [EventKind.LANE_CHANGE]), find([first], [EventKind.LANE_CHANGE])
    assert len(alone) > 2
    moments = {(each.event.ego, each.event.step + Scenario.load(each.scenario).start_frame) for each in both}
    assert len(moments) == len(both)
    assert both[: len(alone)] == alone


def test_an_event_that_the_end_of_a_piece_cuts_off_is_of_the_first(tmp_path: Path) -> None:
    pieces = [scenario_file(tmp_path, f"from_{frame}", start_frame=frame, simulation_s=8.0) for frame in (0, 40, 80)]
    start = {piece: Scenario.load(piece).start_frame for piece in pieces}
    lasting = [
        (
            each.event.ego,
            each.event.other,
            start[each.scenario] + each.event.begin,
            start[each.scenario] + each.event.end,
        )
        for each in find(pieces, [EventKind.FOLLOWING])
    ]
    assert len(lasting) > 20
    assert all(a[:2] != b[:2] or a[3] < b[2] for a, b in pairwise(sorted(lasting)))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nowhere",), "no such scenario"),
        (("demo", "--events", "crash"), "is no event, expected some of cut_in"),
        (("demo", "--events", "merge,merge"), "named twice"),
        (("demo", "--events", "merge=0"), "expected a whole number"),
        (("demo", "--hardest", "2", "--spread", "2"), "not allowed with"),
        (("demo", "--pack"), "--pack goes with --out"),
    ],
)
def test_bad_arguments_are_said_in_one_line(
    words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert called(*words) == EXIT_INPUT
    assert said in capsys.readouterr().err


def test_nothing_found_is_no_success(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert called("demo", "--events", "left_turn", "--out", tmp_path / "s.yaml") == EXIT_FAILED
    assert f"error: no event is found: {tmp_path / 's.yaml'} is not written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_default_leaves_out_what_happens_all_the_time() -> None:
    assert set(EventKind) - set(parse_events(None)) == {EventKind.FOLLOWING, EventKind.TURN}
    assert parse_events("merge, cut_in=3") == {EventKind.MERGE: None, EventKind.CUT_IN: 3}
    with pytest.raises(InputError, match="is no event"):
        parse_events("")


def test_a_packed_suite_stands_for_itself(tmp_path: Path) -> None:
    source, out = tmp_path / "source", tmp_path / "packed.yaml"
    late = scenario_file(source, "late", start_frame=5, simulation_s=15.0)
    asked = (late, "--events", "lane_change", "--hardest", "2", "--out", out)
    assert called(*asked) == 0
    plain = Suite.load(out)
    assert called(*asked, "--pack") == 0
    before = Scenario.load(late)
    shutil.rmtree(source)
    packed = Suite.load(out)
    assert {case.scenario for case in packed.cases} == {str(tmp_path / "packed" / f"{before.name}.yaml")}
    assert [(case.ego_id, case.events) for case in packed.cases] == [(case.ego_id, case.events) for case in plain.cases]
    after = Scenario.load(packed.cases[0].scenario)
    assert (after.start_frame, after.total_steps, after.egos) == (5, 180, before.egos)
    pd.testing.assert_frame_equal(after.recording.table, before.recording.table)
    assert after.net_path == before.net_path
