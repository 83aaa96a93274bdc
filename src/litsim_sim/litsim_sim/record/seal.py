"""The seal of a record: what its run came to, told by the bridge to the launcher and not over topics, and signed.

A stack that drives the ego can publish whatever it likes, and so have a record say what did not happen. The seal is
written beside the bag once all processes of the run have ended; whoever reads the record compares both.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from litsim_sim.core.errors import InputError, shown
from litsim_sim.core.lockstep import unanswered
from litsim_sim.io.files import write_json
from litsim_sim.io.yaml_input import load_yaml
from litsim_sim.record.bag import SEAL_FILE, find_mcap

KEY_VARIABLE = "LITSIM_SEAL_KEY"
"""Variable that names the file of the key; then records without a seal by that key are refused."""
KEY_BYTES, KEY_ID_DIGITS = 32, 16
UNSIGNED = "not signed"
NO_SEAL = "none: only the record itself says what happened"


@dataclass(frozen=True)
class RunFacts:
    """What a run came to.

    Attributes:
        run_id: id of the run.
        step: last step.
        digest: digest of all steps, see :class:`litsim_sim.record.digest.RunDigest`.
        wall_s: wall time since step 0 [s].
        summary: summary of the bridge, in YAML.
    """

    run_id: str
    step: int
    digest: str
    wall_s: float
    summary: str

    @property
    def text(self) -> str:
        """The facts as one line, for :meth:`of_text`."""
        return json.dumps(asdict(self))

    @classmethod
    def of_text(cls, text: str) -> RunFacts:
        """Inverts :attr:`text`; raises ValueError or TypeError if it is malformed."""
        return cls(**json.loads(text))

    def differences(self, record: RunFacts) -> list[str]:
        """Returns where a `record` says something else than these facts; empty for a record of this run.

        The digest is not compared if answers were missed: what the bridge held in their place is not recorded.
        """
        sealed, recorded = asdict(self), asdict(record)
        summaries = [summary_fields(facts.pop("summary")) for facts in (sealed, recorded)]
        if unanswered(summaries[0]):
            del sealed["digest"]
        for name in sorted({*summaries[0], *summaries[1]}):
            sealed[name], recorded[name] = (summary.get(name) for summary in summaries)
        return [
            f"{name} is {shown(recorded[name])}, sealed is {shown(value)}"
            for name, value in sealed.items()
            if recorded[name] != value
        ]


@dataclass(frozen=True)
class Seal:
    """The seal of a record as it is read.

    Attributes:
        facts: what the run came to; None without a seal, or if it cannot be read.
        signature: text about its signature.
        problem: why the record is not what was sealed, whatever it says; empty if that is not known.
    """

    facts: RunFacts | None
    signature: str
    problem: str = ""

    def flaws(self, record: RunFacts) -> list[str]:
        """Returns why a record that says `record` is not to be believed; empty if it is, or has no seal."""
        apart = [] if self.facts is None else self.facts.differences(record)
        told = f"the record says something else than what happened: {'; '.join(apart)}" if apart else ""
        return [text for text in (self.problem, told) if text]


@lru_cache(maxsize=4)
def summary_fields(summary: str) -> Mapping[str, Any]:
    """Returns the fields of a bridge's summary in YAML; none of a text that has none. Cached for seal and record."""
    fields = load_yaml(summary, "summary of the run")
    return fields if isinstance(fields, dict) else {}


def write_seal(folder: Path, facts: RunFacts) -> None:
    """Seal the record in `folder`, after its run; raises InputError if there is none or the seal cannot be written."""
    content = {"facts": asdict(facts), "sha256": _sha256(find_mcap(folder))}
    key = _key(make=True)
    signed = content | {"key": _key_id(key), "hmac": _hmac(content, key)}
    write_json(folder / SEAL_FILE, signed)


def read_seal(mcap: Path) -> Seal:
    """Returns the seal of the record in the file `mcap`; raises InputError if a key is named that cannot be read."""
    key, file = _key(make=False), mcap.parent / SEAL_FILE
    required = KEY_VARIABLE in os.environ
    if not file.is_file() or len(list(mcap.parent.glob("*.mcap"))) > 1:  # of several, it is not known whose it is
        return Seal(None, NO_SEAL, f"there is no {SEAL_FILE} beside it, which {KEY_VARIABLE} requires" * required)
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        signed_by, signature = str(content.pop("key")), str(content.pop("hmac"))
        facts = RunFacts(**content["facts"])
        sha256 = str(content["sha256"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        return Seal(None, UNSIGNED, f"{SEAL_FILE} cannot be read: {type(error).__name__}")
    own = bool(key) and signed_by == _key_id(key)
    problem = ""
    if own and not hmac.compare_digest(signature, _hmac(content, key)):
        problem = f"{SEAL_FILE} has changed since it was signed"
    elif required and not own:
        problem = f"{SEAL_FILE} is signed by key {shown(signed_by)}, expected {_key_id(key)} ({KEY_VARIABLE})"
    elif sha256 != _sha256(mcap):
        problem = f"{mcap.name} has changed since it was sealed"
    return Seal(facts, _described(signed_by, own), problem)


def _described(signed_by: str, own: bool) -> str:
    if own:
        return "signed by the key of this user"
    return f"signed by key {shown(signed_by)}, which is not here" if signed_by else UNSIGNED


def _hmac(content: Mapping[str, Any], key: bytes) -> str:
    text = json.dumps(content, sort_keys=True).encode()
    return hmac.new(key, text, hashlib.sha256).hexdigest() if key else ""


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


def _key_id(key: bytes) -> str:
    """Returns what a key is called, of which it tells nothing; empty without one."""
    return hashlib.sha256(b"litsim seal " + key).hexdigest()[:KEY_ID_DIGITS] if key else ""


def _key(*, make: bool) -> bytes:
    """Returns the key of seals, made if need be and if `make`; empty if there is none, as where no home is writable.

    Raises:
        InputError: :data:`KEY_VARIABLE` names a file that cannot be read or is too short.
    """
    if named := os.environ.get(KEY_VARIABLE):
        try:
            key = Path(named).read_bytes()
        except OSError as error:
            raise InputError(f"{KEY_VARIABLE}: {named}: {error.strerror}") from error
        if len(key) < KEY_BYTES:
            raise InputError(f"{KEY_VARIABLE}: {named} has {len(key)} bytes, expected at least {KEY_BYTES}")
        return key
    with suppress(OSError, RuntimeError):  # there is no home
        path = Path(os.environ.get("XDG_STATE_HOME") or "~/.local/state").expanduser() / "litsim/seal.key"
        if make and not path.exists():
            _make_key(path)
        return path.read_bytes()
    return b""


def _make_key(path: Path) -> None:
    """Make a key that this user alone can read, unless another process has made it meanwhile; raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(f".{os.getpid()}.{path.name}")
    with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(secrets.token_bytes(KEY_BYTES))
    try:
        with suppress(FileExistsError):
            os.link(new, path)
    finally:
        new.unlink()
