"""The tutorials: every command on a page is run in order, and prints what the page shows."""

import re
import shlex
import subprocess
from collections.abc import Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import pytest

from litsim_data.cli import main as data
from litsim_eval.cli import compare, evaluate, report

ROOT = Path(__file__).resolve().parents[2]
MADE = {
    "first-run": ("first/replay/report.html", "first/litsim/report.html", "first/campaign/experiment.html"),
    "your-stack": ("stack/blind/experiment.html", "stack/sighted/junit.xml"),
    "your-own-recording": tuple(
        f"mine/{name}"
        for name in ("check.png", "tracks.html", "litsim/report.html", "campaign/experiment.html", "campaign/junit.xml")
    ),
}
"""What a page leaves, by its name."""
BLOCK = re.compile(r"^```(bash|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HERE = {"data": data, "compare": compare.main, "report": report.main, "evaluate": evaluate.main}
STATUS = re.compile(r"\s+# status (\d)$")


@dataclass
class Step:
    """A block of commands, and the lines that it prints, among others, in their order."""

    commands: list[str]
    shown: list[str] = field(default_factory=list)


def steps(page: str) -> list[Step]:
    found: list[Step] = []
    for kind, text in BLOCK.findall((ROOT / f"docs/{page}.md").read_text(encoding="utf-8")):
        if kind == "bash":
            found.append(Step(list(commands(text))))
        else:
            found[-1].shown += text.splitlines()
    return found


def commands(text: str) -> Iterator[str]:
    """The commands of a block, those with a text after << or between quotes whole."""
    lines = iter(text.splitlines())
    for line in lines:
        ending = re.search(r"<<'(\w+)'$", line)
        command = [line]
        while command[-1] != ending[1] if ending else "\n".join(command).count('"') % 2:
            command.append(next(lines))
        yield "\n".join(command)


@pytest.fixture
def checkout(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A folder that looks like this checkout to the commands of a page."""
    if request.node.callspec.params["page"] == "your-own-recording":
        request.getfixturevalue("netconvert")
        pytest.importorskip("lanelet2", reason="the lanelet2 package is not installed: requirements/maps.txt")
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    (tmp_path / "litsim").symlink_to(ROOT / "litsim")
    return tmp_path


def run(command: str, folder: Path) -> tuple[int, str]:
    """Exit status and output of a command, of one of LitSim without a graph in this process."""
    program, _, arguments = command.partition(" ")
    if program == "./litsim" and (verb := arguments.partition(" ")[0]) in HERE:
        said = StringIO()
        with chdir(folder), redirect_stdout(said), redirect_stderr(said):
            try:
                HERE[verb](shlex.split(arguments, comments=True)[1:])
            except SystemExit as ended:
                return int(ended.code or 0), said.getvalue()
        return 0, said.getvalue()
    done = subprocess.run(["bash", "-c", command], cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.graph
@pytest.mark.parametrize("page", MADE)
def test_every_command_of_the_page(page: str, checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    for step in steps(page):
        printed = ""
        for command in step.commands:
            expected = STATUS.search(command)
            status, said = run(STATUS.sub("", command), checkout)
            assert status == (int(expected[1]) if expected else 0), f"{command}\n{said}"
            printed += said
        at = 0
        for line in step.shown:
            pattern = r"[^\n]*".join(re.escape(part) for part in re.split(r"\s*…\s*", line.strip()))
            found = re.compile(pattern).search(printed, at)
            assert found, f"{step.commands[-1]}\nshould print, after what is shown before it: {line}\n{printed}"
            at = found.end()
    for made in MADE[page]:
        assert (checkout / made).stat().st_size > 1000, made
