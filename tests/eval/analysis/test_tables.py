"""The Parquet files of a run, read back and compared with the run and with its metrics."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from litsim_data.surrogates.safety import safety_series
from litsim_eval.analysis.measures.comfort import comfort
from litsim_eval.analysis.measures.displacement import displacements
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.analysis.tables import SERIES, TAKEOVERS, series_tables, write_tables
from litsim_sim.core.scene import Controller
from litsim_sim.core.takeover import TakeoverState
from litsim_sim.record.run import Run
from made_agents import takeover
from made_runs import make_run, moved, table

DOCS = Path(__file__).resolve().parents[3] / "docs/metrics.md"
HISTORY, STEPS, EGO, TAKEN = 5, 40, 1, 2


@pytest.fixture
def run() -> Run:
    """The ego falls back towards agent 2, which is taken over from step 12 to 30; 3 crosses behind; 4 comes late."""
    log, tables, takeovers = [], [], {}
    for k in range(STEPS + 1):
        rows = [
            {"id": 1, "x": 60.0 + k, "y": 0.0},
            {"id": 2, "x": 40.0 + k, "y": 0.0},
            {"id": 3, "x": 55.0, "y": k - 30.0, "yaw": np.pi / 2},
            *([{"id": 4, "x": 100.0 + 1.5 * k, "y": 0.0, "speed": 15.0}] if k >= 20 else []),
        ]
        log.append(table(k, *rows))
        late = max(0, k - HISTORY)
        ego = {"x": -0.01 * late**2, "speed": 10.0 - 0.2 * late, "acceleration": -2.0 if late else 0.0}
        now = moved([log[-1]], EGO, controller=Controller.EGO, x=ego["x"], speed=0.0, acceleration=0.0)
        now = [replace(t, speed=np.where(t.id == EGO, ego["speed"], t.speed)) for t in now]
        now = [replace(t, acceleration=np.where(t.id == EGO, ego["acceleration"], t.acceleration)) for t in now]
        if 12 < k <= 30:
            now = moved(now, TAKEN, x=-0.1, controller=Controller.POLICY)
        if 12 <= k <= 30:
            state = TakeoverState.RELEASED if k == 30 else TakeoverState.HANDBACK if k > 25 else TakeoverState.HELD
            takeovers[k] = [takeover(TAKEN, EGO, state=state, detected_step=12)]
        tables += now
    run: Run = make_run(tables, log, history_steps=HISTORY, takeovers=takeovers)
    return run


@pytest.fixture
def files(run: Run, tmp_path: Path) -> Path:
    write_tables(run, tmp_path)
    return tmp_path


@pytest.fixture
def series(files: Path) -> pd.DataFrame:
    return pd.read_parquet(files / "series.parquet")


def of(series: pd.DataFrame, agent: int) -> pd.DataFrame:
    return series[series["agent"] == agent].set_index("step")


def test_states_are_those_of_the_run(run: Run, series: pd.DataFrame) -> None:
    names = {"id": "agent", "x": "x_m", "y": "y_m", "yaw": "yaw_rad", "speed": "speed_mps"}
    names |= {"acceleration": "acceleration_mps2", "yaw_rate": "yaw_rate_radps", "length": "length_m"}
    assert series["step"].unique().tolist() == list(range(HISTORY + 1, STEPS + 1))
    for scene in run.simulated:
        rows = series[series["step"] == scene.step]
        for field, name in names.items():
            assert rows[name].tolist() == getattr(scene, field).tolist()
        assert rows["controller"].tolist() == [Controller(c).name.lower() for c in scene.controller]
        assert (rows["time_s"] == scene.step * run.info.dt).all()
    assert set(series["run_id"]) == {run.info.run_id}
    taken = of(series, TAKEN)["takeover"]
    assert taken.loc[12:30].tolist() == ["held"] * 14 + ["handback"] * 4 + ["released"]
    assert taken.count() == series["takeover"].count() == 19


def test_measures_are_those_of_the_metrics(run: Run, series: pd.DataFrame) -> None:
    metrics, ego = compute_metrics(run), of(series, EGO)
    expected = safety_series(run.simulated, EGO)
    for name, values in (("ttc_s", expected.ttc), ("headway_s", expected.headway)):
        assert ego[name].fillna(np.inf).tolist() == values.tolist()
    assert ego["drac_mps2"].fillna(0.0).tolist() == expected.drac.tolist()
    assert metrics["safety"]["min_headway_s"] == ego["headway_s"].min()
    assert series["pet_s"].min() <= metrics["safety"]["min_pet_s"]
    far = displacements(run)
    assert series["deviation_m"].dropna().tolist() == far.distance.tolist()
    assert metrics["ade_ego_m"] == {}  # 3.5 s
    for agent in (1, 2, 3, 4):
        felt = comfort(run.simulated, agent, run.info.dt)
        assert felt is not None
        assert of(series, agent)["comfortable"].all() == felt.comfortable


def test_relations_between_agents(run: Run, series: pd.DataFrame) -> None:
    behind = of(series, TAKEN)
    assert set(behind["leader"].dropna()) == {EGO}
    at = run.tables[20]
    assert behind.loc[20, "gap_m"] == pytest.approx(at.x[0] - at.x[1] - 4.0)
    assert behind.loc[20, "speed_deviation_mps"] == 0.0
    assert of(series, EGO).loc[HISTORY + 10, "speed_deviation_mps"] == pytest.approx(-2.0)
    assert of(series, 4).index[0] == 20
    first = of(series, 4).iloc[0]
    assert pd.isna(first["jerk_mps3"]) and first["comfortable"] and pd.isna(first["leader"])
    crossing = of(series, 3)
    assert set(crossing["pet_agent"].dropna()) == {TAKEN}
    assert crossing["pet_s"].min() == pytest.approx(1.0)


def test_takeovers_are_the_ledger_of_the_metrics(run: Run, files: Path) -> None:
    rows = pq.read_table(files / "takeovers.parquet").to_pylist()
    assert [{k: v for k, v in row.items() if k != "run_id"} for row in rows] == compute_metrics(run)["ledger"]
    assert len(rows) == 1
    assert rows[0]["run_id"] == run.info.run_id


def test_the_run_is_named_in_the_files(run: Run, files: Path) -> None:
    for name, schema in (("series", SERIES), ("takeovers", TAKEOVERS)):
        found = pq.read_schema(files / f"{name}.parquet")
        assert found.names == ["run_id", *schema.names]
        assert found.metadata[b"scenario"] == run.info.scenario.encode()
    assert sorted(path.name for path in files.iterdir()) == ["series.parquet", "takeovers.parquet"]


def test_nothing_is_nan_or_infinite(series: pd.DataFrame, files: Path) -> None:
    table = pq.read_table(files / "series.parquet")
    for name in table.column_names:
        values = table[name].drop_null().to_pylist()
        assert not [v for v in values if isinstance(v, float) and not np.isfinite(v)], name
    assert series["ttc_s"].isna().any() and series["gap_m"].isna().any()


def whole(run: Run) -> pa.Table:
    return pa.concat_tables(series_tables(run))


@pytest.mark.parametrize("rows_max", [1, 10, 50])
def test_a_series_in_many_parts_is_the_same(run: Run, rows_max: int, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = whole(run).to_pylist()
    monkeypatch.setattr("litsim_eval.analysis.tables.ROWS_MAX", rows_max)
    parts = list(series_tables(run))
    assert len(parts) > 1 and max(len(part) for part in parts[:-1]) <= max(rows_max, 4)
    assert pa.concat_tables(parts).unify_dictionaries().to_pylist() == expected


def test_runs_without_log_agents_or_steps() -> None:
    lonely = whole(make_run([table(k, {"id": 5, "x": float(k), "y": 0.0}) for k in range(3)], log=[]))
    assert len(lonely) == 2
    assert lonely["deviation_m"].null_count == lonely["pet_s"].null_count == 2
    nobody = whole(make_run([table(k) for k in range(3)]))
    assert (len(nobody), nobody.schema.names) == (0, lonely.schema.names)
    assert len(whole(make_run([table(0, {"id": 5, "x": 0.0, "y": 0.0})]))) == 0  # history only


def test_every_column_is_documented() -> None:
    text = DOCS.read_text()
    assert [name for name in (*SERIES.names, *TAKEOVERS.names) if f"`{name}`" not in text] == []
