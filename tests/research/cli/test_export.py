"""`export` as a person uses it."""

from pathlib import Path

import pytest

from command_line import refusal
from litsim_predictor.models import make_predictor
from litsim_research.cli.export import main
from litsim_sim.scenario.scenario import Scenario


def test_what_is_exported_predicts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "mine.onnx"
    main(["--weights", "paper", "--out", str(out)])
    assert capsys.readouterr().out.strip() == str(out)
    scenario = Scenario.load("demo")
    table = scenario.log.table(0)
    mine, shipped = (make_predictor(name, scenario).forecast(table) for name in (str(out), "paper"))
    assert len(mine.id) and (mine.mean == shipped.mean).all()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--weights", "none.safetensors", "--out", "x.onnx"], "none.safetensors: no such weights"),
        (["--weights", "paper", "--out", "x.bin"], "--out x.bin: expected a name that ends in .onnx"),
    ],
)
def test_what_cannot_be_exported_is_refused(
    arguments: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert named in refusal(capsys, main, *arguments)
