"""Pictures of runs: which moment they show, and where everything stands in it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.report.thumbnails import THUMBNAIL_FILE, read_thumbnail, thumbnail_of, write_thumbnail
from litsim_sim.core.colours import Mode
from litsim_sim.record.run import Run

EGO, FOLLOWER, DETECTED = 1, 2, 20  # of the small run


@pytest.fixture(scope="module")
def metrics(small_run: Run) -> dict[str, Any]:
    """Of the small run, as if nobody had touched."""
    found = compute_metrics(small_run)
    return found | {"collision": found["collision"] | {"contacts": []}}


def touching(metrics: dict[str, Any], *contacts: tuple[list[int], int, bool]) -> dict[str, Any]:
    found = [{"pair": pair, "step": step, "in_log": in_log} for pair, step, in_log in contacts]
    return metrics | {"collision": metrics["collision"] | {"contacts": found}}


def test_a_takeover_is_shown_a_second_after_its_detection(small_run: Run, metrics: dict[str, Any]) -> None:
    picture = thumbnail_of(small_run, metrics)
    assert (picture["step"], picture["what"]) == (DETECTED + 10, f"agent {FOLLOWER} is taken over")
    assert picture["contact"] is None
    boxes = {box[5]: box for box in picture["boxes"]}
    assert boxes[Mode.EGO][:5] == [0, 0, 0, 45, 20]
    table = small_run.tables[DETECTED + 10]
    behind = float(table.x[1] - table.x[0])
    assert boxes[Mode.POLICY][:2] == [round(10 * behind), 0]


def test_a_contact_of_the_ego_goes_first_and_is_marked(small_run: Run, metrics: dict[str, Any]) -> None:
    contacts = (([3, 4], 15, False), ([EGO, FOLLOWER], 33, False), ([EGO, 5], 12, True))
    picture = thumbnail_of(small_run, touching(metrics, *contacts))
    assert (picture["step"], picture["what"]) == (33, "agents 1 and 2 touch")
    table = small_run.tables[33]
    assert picture["contact"] == [round(5 * float(table.x[1] - table.x[0])), 0]


def test_a_contact_far_from_the_ego_is_in_the_middle(small_run: Run, metrics: dict[str, Any]) -> None:
    picture = thumbnail_of(small_run, touching(metrics, ([100, 101], 40, False)))
    assert picture["what"] == "agents 100 and 101 touch"
    assert [0, 0] in [box[:2] for box in picture["boxes"]]
    assert Mode.EGO not in {box[5] for box in picture["boxes"]}


def test_without_events_the_ego_is_shown_where_it_came_nearest(small_run: Run, metrics: dict[str, Any]) -> None:
    quiet = metrics | {"ledger": []}
    nearest = thumbnail_of(small_run, quiet)
    assert nearest["what"] == "the ego's shortest time to collision"
    alone = replace(small_run, tables=[table.take(table.id == EGO) for table in small_run.tables], takeovers={})
    assert thumbnail_of(alone, quiet)["what"] == "the middle of the run"


def test_road_and_paths_lie_in_the_picture(small_run: Run, metrics: dict[str, Any]) -> None:
    picture = thumbnail_of(small_run, metrics)
    half_length, half_height = picture["size"]
    assert picture["road"] and picture["path"] and picture["log"]
    for line in (*picture["road"], *picture["path"], *picture["log"]):
        x, y = np.reshape(line, (-1, 2)).T
        assert (np.abs(x) <= half_length + 50).all() and (np.abs(y) <= half_height + 50).all()
    assert all(isinstance(v, int) for line in picture["road"] for v in line)


def test_without_a_net_or_an_ego_there_is_still_a_picture(small_run: Run, metrics: dict[str, Any]) -> None:
    assert thumbnail_of(replace(small_run, net_xml=b""), metrics)["road"] == []
    gone = replace(small_run, tables=[table.take(table.id > 2) for table in small_run.tables], takeovers={})
    picture = thumbnail_of(gone, metrics)
    assert picture["boxes"] == [] and picture["path"] == []


def test_it_is_small_and_read_as_it_was_written(small_run: Run, metrics: dict[str, Any], tmp_path: Path) -> None:
    write_thumbnail(small_run, metrics, tmp_path)
    assert (tmp_path / THUMBNAIL_FILE).stat().st_size < 2000
    assert read_thumbnail(tmp_path) == thumbnail_of(small_run, metrics)


@pytest.mark.parametrize("text", [None, "no JSON", "[]", json.dumps({"format": 0})])
def test_none_of_todays_format_is_none(text: str | None, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / THUMBNAIL_FILE).write_text(text)
    assert read_thumbnail(tmp_path) is None
