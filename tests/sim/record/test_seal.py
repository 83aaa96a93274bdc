"""The seal of a record: what it tells apart, who can sign, and what is required where a key is named."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.record.bag import SEAL_FILE, make_room
from litsim_sim.record.seal import KEY_VARIABLE, NO_SEAL, UNSIGNED, RunFacts, read_seal, write_seal

SUMMARY = "missed: {}\ncontacts: 4\nended: {reason: net_end, step: 217, lane: ''}\n"
FACTS = RunFacts("run-1", 217, "00ff", 3.5, SUMMARY)
Edit = Callable[[dict[str, Any]], Any]


@pytest.fixture
def mcap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A sealed file, on the machine of whoever has sealed it."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.delenv(KEY_VARIABLE, raising=False)
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run_0.mcap").write_bytes(b"what was recorded")
    write_seal(folder, FACTS)
    return folder / "run_0.mcap"


def edit(mcap: Path, change: Edit) -> None:
    seal = mcap.parent / SEAL_FILE
    content = json.loads(seal.read_text())
    change(content)
    seal.write_text(json.dumps(content))


def test_an_honest_record_has_no_flaws_and_its_key_is_for_its_user_alone(mcap: Path, tmp_path: Path) -> None:
    seal = read_seal(mcap)
    assert (seal.facts, seal.flaws(FACTS), seal.signature) == (FACTS, [], "signed by the key of this user")
    assert (tmp_path / "state/litsim/seal.key").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"run_id": "run-2"}, "run_id is 'run-2', sealed is 'run-1'"),
        ({"step": 100}, "step is 100, sealed is 217"),
        ({"digest": "00fe"}, "digest is '00fe', sealed is '00ff'"),
        ({"wall_s": 5.0}, "wall_s is 5.0, sealed is 3.5"),
        ({"summary": SUMMARY.replace("4", "0")}, "contacts is 0, sealed is 4"),
        ({"summary": SUMMARY + "more: 1"}, "more is 1, sealed is None"),
        ({"summary": SUMMARY.replace("{}", "{/c: 1}")}, "missed is {'/c': 1}, sealed is {}"),
        ({"summary": ""}, "contacts is None, sealed is 4"),
        ({"summary": "[1]"}, "contacts is None, sealed is 4"),
    ],
)
def test_a_record_that_says_something_else_is_told_where(mcap: Path, told: dict[str, Any], said: str) -> None:
    (flaw,) = read_seal(mcap).flaws(replace(FACTS, **told))
    assert flaw.startswith("the record says something else than what happened: ") and said in flaw


def test_what_was_held_in_place_of_a_missed_answer_is_not_in_the_record() -> None:
    missed = replace(FACTS, summary=SUMMARY.replace("{}", "{/litsim/controls: 1}"))
    assert missed.differences(replace(missed, digest="00fe")) == []


def test_a_file_that_has_changed_is_told(mcap: Path) -> None:
    mcap.write_bytes(b"what was not recorded")
    assert read_seal(mcap).flaws(FACTS) == ["run_0.mcap has changed since it was sealed"]


@pytest.mark.parametrize(
    "change", [lambda c: c["facts"].update(step=100), lambda c: c.update(sha256="0"), lambda c: c.update(hmac="")]
)
def test_a_seal_that_has_changed_is_told_where_its_key_is(mcap: Path, change: Edit) -> None:
    edit(mcap, change)
    assert f"{SEAL_FILE} has changed since it was signed" in read_seal(mcap).flaws(FACTS)


@pytest.mark.parametrize("change", [lambda c: c.pop("facts"), lambda c: c["facts"].update(more=1), lambda c: c.clear()])
def test_a_seal_that_is_none_is_a_flaw(mcap: Path, change: Edit) -> None:
    edit(mcap, change)
    (flaw,) = read_seal(mcap).flaws(FACTS)
    assert flaw.startswith(f"{SEAL_FILE} cannot be read: ")


def test_on_another_machine_the_content_is_checked_and_the_signature_is_not(
    mcap: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "elsewhere"))
    seal = read_seal(mcap)
    assert seal.signature.endswith(", which is not here") and seal.flaws(FACTS) == []
    assert not (tmp_path / "elsewhere").exists()
    assert "step is 100" in seal.flaws(replace(FACTS, step=100))[0]


def test_a_key_that_is_named_is_required(mcap: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KEY_VARIABLE, str(tmp_path / "key"))
    with pytest.raises(InputError, match=f"^{KEY_VARIABLE}: .*key: No such file"):
        read_seal(mcap)
    (tmp_path / "key").write_bytes(bytes(31))
    with pytest.raises(InputError, match=r"has 31 bytes, expected at least 32$"):
        write_seal(mcap.parent, FACTS)
    (tmp_path / "key").write_bytes(bytes(range(32)))
    assert "is signed by key" in read_seal(mcap).flaws(FACTS)[0]
    write_seal(mcap.parent, FACTS)
    assert read_seal(mcap).flaws(FACTS) == []
    (mcap.parent / SEAL_FILE).unlink()
    assert read_seal(mcap).flaws(FACTS) == [f"there is no {SEAL_FILE} beside it, which {KEY_VARIABLE} requires"]


def test_without_a_home_nothing_is_signed(mcap: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/dev/null")
    write_seal(mcap.parent, FACTS)
    seal = read_seal(mcap)
    assert (seal.flaws(FACTS), seal.signature) == ([], UNSIGNED)


def test_an_old_record_is_said_to_have_none_and_a_new_run_removes_it(mcap: Path) -> None:
    make_room(mcap.parent, overwrite=True)
    assert not (mcap.parent / SEAL_FILE).exists()
    seal = read_seal(mcap)
    assert (seal.flaws(FACTS), seal.signature) == ([], NO_SEAL)
