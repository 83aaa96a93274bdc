"""The example exports a log and a map that py123d itself has written; tests/data/sources imports what it exports."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import made_sources

EXAMPLE = Path(__file__).parents[2] / "examples/py123d"
PYTHON = EXAMPLE / ".venv/bin/python"


@pytest.mark.skipif(
    not (EXAMPLE / ".venv/.made-from").is_file(),
    reason="py123d's environment is not there; make it: examples/py123d/setup.sh",
)
def test_a_log_of_py123d_is_exported(tmp_path: Path) -> None:
    (tmp_path / "crossing.json").write_text(json.dumps(made_sources.crossing()))
    writer = Path(__file__).parents[1] / "helpers/py123d_log.py"
    subprocess.run([PYTHON, writer, tmp_path / "crossing.json", tmp_path / "data"], check=True)
    export = [PYTHON, EXAMPLE / "export.py", tmp_path / "data", tmp_path / "out"]
    done = subprocess.run(export, check=True, capture_output=True, text=True)
    path = tmp_path / "out/nuplan_made.parquet"
    assert done.stdout == f"{path}: 555 rows, 5 tracks, 7 lanes, 1 lights\n"
    exported, expected = (pq.read_table(file) for file in (path, made_sources.py123d(tmp_path / "expected.parquet")))
    own, right = (table.to_pandas().sort_values(["time_us", "vehicle_id"]) for table in (exported, expected))
    assert own.columns.tolist() == right.columns.tolist()
    for name, values in own.items():
        if pa.types.is_floating(exported.schema.field(name).type):
            np.testing.assert_allclose(values, right[name], atol=1e-6, err_msg=name)
        else:
            assert values.tolist() == right[name].tolist(), name
    contents = [json.loads(table.schema.metadata[b"py123d"]) for table in (exported, expected)]
    for content in contents:
        content["lanes"].sort(key=lambda lane: int(lane["id"]))
    assert contents[0] == contents[1]


def test_a_folder_without_logs_is_told(tmp_path: Path) -> None:
    """Without py123d: its modules are empty ones."""
    for name in ("api/scene/arrow/arrow_scene_api", "datatypes/__init__"):
        file = tmp_path / f"stand_in/py123d/{name}.py"
        file.parent.mkdir(parents=True)
        file.write_text("ArrowSceneAPI = LaneType = MapLayer = None\n")
    export = [sys.executable, EXAMPLE / "export.py", tmp_path, tmp_path / "out"]
    alone = {"PYTHONPATH": str(tmp_path / "stand_in")}
    done = subprocess.run(export, capture_output=True, text=True, env=alone, check=False)
    expected = f"export.py: {tmp_path}: holds no log of py123d (sync.arrow); `py123d-conversion` makes them\n"
    assert (done.returncode, done.stderr) == (1, expected)
