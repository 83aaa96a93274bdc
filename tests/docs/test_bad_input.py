"""The table of bad input in docs/faults.md: everything in it is tried, and what it quotes is what is said."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from litsim_data.cli import main as data
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.recording import COLUMNS, Recording, RecordingHeader
from litsim_sim.scenario.scenario import Scenario, packaged

PAGE = Path(__file__).resolve().parents[2] / "docs" / "faults.md"
MAPPING = {
    "name": "mine",
    "reference": "box_centre",
    "columns": {"vehicle_id": "id", "time": "t", "x": "x", "y": "y", "length": 4.5, "width": 1.8},
}


def rows() -> dict[str, str]:
    """By what is given, what is said, as the page has it."""
    section = PAGE.read_text(encoding="utf-8").partition("## Bad input")[2].partition("\n## ")[0]
    cells = [line.strip("|").split(" | ") for line in section.splitlines() if line.startswith("|")]
    return {given.strip(): said.strip() for given, said in cells[2:]}


@dataclass
class Tried:
    """A folder in which bad input is tried."""

    folder: Path
    capsys: pytest.CaptureFixture[str]

    def scenario(self, **fields: Any) -> str:
        """What loading a scenario with these fields says."""
        usual = {"name": "mine", "recording": str(packaged("scenarios/us101_like.parquet")), "net": "us101_like"}
        return self.text(yaml.safe_dump(usual | {"ego": 7} | fields))

    def text(self, text: str) -> str:
        """What loading a scenario of this text says."""
        path = self.folder / "mine.yaml"
        path.write_text(text)
        with pytest.raises(InputError) as refused:
            Scenario.load(path)
        return str(refused.value).replace(f"{self.folder}/", "")

    def table(self, table: pd.DataFrame) -> str:
        """What converting a table says, all of it."""
        mapping, source, out = (self.folder / name for name in ("mapping.yaml", "mine.csv", "mine.parquet"))
        mapping.write_text(yaml.safe_dump(MAPPING))
        table.to_csv(source, index=False)
        status = 0
        try:
            data(["convert", "--mapping", str(mapping), str(source), str(out)])
        except SystemExit as ended:
            status = int(ended.code or 0)
        said = self.capsys.readouterr()
        assert status in (0, 2) and out.is_file() == (status == 0)
        return said.err.removeprefix("error: ").replace(f"{self.folder}/", "") if status else said.out


def traffic() -> pd.DataFrame:
    """Two vehicles one behind the other, 10 rows a second."""
    t = np.arange(0.0, 5.0, 0.1).round(1)
    return pd.concat([pd.DataFrame({"id": i, "t": t, "x": 20.0 * i + 10.0 * t, "y": 3.0}) for i in (1, 2)])


def recording_with(value: float) -> str:
    """What is said of a recording with this speed in its third row."""
    table = pd.DataFrame({name: np.zeros(5) for name in COLUMNS} | {"frame": np.arange(5)})
    table = table.assign(vehicle_id=12, length=4.0, width=2.0)
    table.loc[2, "speed"] = value
    with pytest.raises(InputError) as refused:
        Recording.from_table(RecordingHeader("mine"), table, "mine.parquet")
    return str(refused.value)


TRIED: dict[str, Callable[[Tried], str]] = {
    "`simulation_s: .inf`": lambda on: on.scenario(simulation_s=float("inf")),
    "`seed:` 10^40": lambda on: on.scenario(seed=10**40),
    "a NUL in a path": lambda on: on.scenario(recording="a\0b"),
    "`name: ../../x`": lambda on: on.scenario(name="../../x"),
    "3000 nested brackets": lambda on: on.text("name: " + "[" * 3000 + "]" * 3000),
    "a key that occurs twice": lambda on: on.text("name: mine\nego: 1\nego: 2\n"),
    "a net that is not there": lambda on: on.scenario(net="crossing"),
    "a goal that the ego cannot reach": lambda on: on.scenario(goal=[0, 900, 0]),
    "a number that is none (NaN)": lambda on: recording_with(float("nan")),
    "rows that are exact copies": lambda on: on.table(pd.concat([traffic(), traffic().head(30)])),
    "rows that put a vehicle at two places": lambda on: on.table(
        pd.concat([traffic(), traffic().head(30).assign(y=9.0)])
    ),
    "a cell that is no number": lambda on: on.table(traffic().assign(y=["?", *[3.0] * 99])),
    "a vehicle that is seen between two frames of 10 Hz only": lambda on: on.table(
        pd.concat([traffic(), pd.DataFrame({"id": 3, "t": [1.02, 1.06], "x": [0.0, 0.4], "y": 9.0})])
    ),
}


@pytest.mark.parametrize("given", TRIED)
def test_what_is_said(given: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    quotes = re.findall(r"`([^`]+)`", rows()[given])
    said = TRIED[given](Tried(tmp_path, capsys))
    assert quotes
    for quote in quotes:
        pattern = ".*".join(re.escape(part.strip()) for part in quote.split("…"))
        assert re.search(pattern, said), f"{quote!r} is not what is said: {said!r}"


def test_every_row_is_tried() -> None:
    assert set(rows()) == set(TRIED)
