"""Records that are damaged anywhere: the same measures, or one line that names the file, and never other figures."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from damage import CUT, FLIP, REFUSED, SHORTER, WAYS, Counts, damage_record, damages, outcomes
from litsim_sim.core.scene import Controller, ControlTable, EgoCommand
from litsim_sim.record.bag import BagReader
from litsim_sim.record.player import CLOCK, messages_of, offered_qos, selected

Make = Callable[..., Any]
STEPS = 24


@pytest.fixture
def record(table: Make, make_run: Make, moved: Make, write_run: Make, tmp_path: Path) -> Path:
    """The MCAP file of a short run with answers of all kinds."""
    log = [table(k, *({"id": a, "x": k + 0.1 * a, "y": 5.0 * a} for a in (1, 2, 9))) for k in range(STEPS + 1)]
    ids, one = np.array([2, 9]), np.array([1, 3], np.uint8)
    run = make_run(
        moved(log, 2, x=1.0 / 3.0, controller=Controller.POLICY),
        log,
        history_steps=4,
        controls={k: ControlTable(k, ids, ids * 0.1, ids * 0.2, ids * 0.3, one) for k in range(STEPS + 1)},
        ego_commands={k: EgoCommand(k, 0.1 * k, -0.1) for k in range(STEPS + 1)},
        timing={"policy": {k: 0.001 * k for k in range(STEPS + 1)}},
    )
    path: Path = write_run(run, tmp_path / "bag") / "run_0.mcap"
    return path


def by_kind(counts: Counts, *ways: str) -> Counter[str]:
    found: Counter[str] = Counter()
    for (way, kind), number in counts.items():
        if not ways or way in ways:
            found[kind] += number
    return found


def test_every_damage_of_a_record_is_refused_and_every_cut_is_said(record: Path) -> None:
    counts = damage_record(record, 1000, 0)
    assert by_kind(counts, FLIP).keys() == {REFUSED}
    assert by_kind(counts).keys() <= {REFUSED, SHORTER}  # what is done to the very end may cut it off
    assert by_kind(counts, *WAYS)[REFUSED] > 900
    assert by_kind(counts, CUT)[SHORTER] > 5


def test_what_is_played_is_what_was_recorded_or_nothing(record: Path) -> None:
    def read(path: Path) -> Any:
        reader = BagReader(path)
        topics = selected(reader)
        return reader.complete, [offered_qos(topic) for topic in topics], messages_of(reader, topics)

    _, recorded, played = read(record)
    qos = [*recorded, offered_qos(CLOCK)]  # of a clock that is cut off
    found = outcomes(
        record,
        damages(record.read_bytes(), 400, 3, cuts=0.1),
        read,
        lambda got: not got[0] and got[2] == played[: len(got[2])] and all(each in qos for each in got[1]),
    )
    assert by_kind(found, FLIP).keys() == {REFUSED}
    assert by_kind(found).keys() == {SHORTER, REFUSED}


def test_what_lies_beside_a_record_changes_nothing(record: Path) -> None:
    beside = record.parent / "metadata.yaml"
    data = beside.read_bytes()
    before = [(m.topic, m.data) for m in BagReader(record.parent).messages()]
    for _, damaged in damages(data, 50, 0):
        beside.write_bytes(damaged)
        assert [(m.topic, m.data) for m in BagReader(record.parent).messages()] == before
