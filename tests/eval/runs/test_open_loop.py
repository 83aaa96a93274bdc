"""Commands of a stack that was played a record, beside those of the record."""

from pathlib import Path

import pytest

from command_line import refusal
from litsim_eval.cli import rerun
from litsim_eval.runs.open_loop import Difference, compared, sentence
from litsim_sim.core.scene import EgoCommand, EgoMode


def test_differences_from_the_end_of_the_history_on() -> None:
    recorded = {k: EgoCommand(k, 1.0, 0.1) for k in range(6)}
    answered = recorded | {1: EgoCommand(1, 9.0), 3: EgoCommand(3, 1.5, 0.1), 4: EgoCommand(4, -0.5, 0.1)}
    del answered[5]
    result = compared(recorded, answered, 2)
    assert result == {"compared": 3, "acceleration": Difference(2.0 / 3.0, 1.5, 4), "yaw_rate": Difference(0.0, 0.0, 2)}
    assert sentence(result) == (
        "3 answers: they differ from the recorded commands: acceleration by 0.667 m/s² in the mean, 1.5 at most "
        "(at 0.4 s); yaw rate by 0 rad/s in the mean, 0 at most"
    )
    assert sentence(result | {"unusable": 3}).endswith("at most; 3 could not be used, and those before were held")


def test_rounding_is_no_difference_and_an_ego_on_its_log_commands_nothing() -> None:
    one, other = {1: EgoCommand(1, 1.0)}, {1: EgoCommand(1, 1.0 + 1e-14)}
    assert sentence(compared(one, other, 0)) == "1 answers: equal to the recorded commands"
    on_log = {1: EgoCommand(1, mode=EgoMode.FOLLOW_LOG)}
    assert sentence(compared(on_log, one, 0)).startswith("no answer can be compared: the ego of the record followed")


@pytest.mark.parametrize("words", [("--out", "out"), ("--", "python3", "stack.py")])
def test_it_needs_a_folder_and_a_stack(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refusal(capsys, rerun.main, tmp_path, "--to-stack", *words)
    assert "--to-stack: expected --out FOLDER, and after -- the command that starts the stack" in said
    assert "after --: expected only with --to-stack" in refusal(capsys, rerun.main, tmp_path, "--resimulate", *words)
