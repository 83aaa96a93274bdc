"""The words that `live` takes."""

import pytest

from command_line import refusal
from litsim_sim.cli.live import main


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--rate", "fast"), "--rate: 'fast', expected a number of more than 0 and at most 100"),
        (("--rate", "0"), "--rate: '0', expected a number of more than 0 and at most 100"),
        (("--rate", "nan"), "--rate: 'nan', expected a number of more than 0 and at most 100"),
        (("--foxglove", "--port", "http"), "--port: 'http', expected 0 to 65535"),
        (("--foxglove", "--port", "65536"), "--port: '65536', expected 0 to 65535"),
        (("--port", "8765"), "--port, --host and --allow-origin go with --foxglove"),
    ],
)
def test_bad_words_are_refused(words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert said in refusal(capsys, main, *words)
