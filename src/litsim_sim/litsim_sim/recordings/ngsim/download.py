"""Fetching NGSIM from the US DOT's portal: resumed where it stopped, checked by size and by the number of rows."""

from __future__ import annotations

import http.client
import json
import time
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from litsim_sim.core.errors import InputError
from litsim_sim.recordings.ngsim import formats as ngsim_format

HOST = "https://data.transportation.gov"
DATASET = "8ect-6jqj"
TITLE = "Next Generation Simulation (NGSIM) Vehicle Trajectories and Supporting Data"
PAGE = f"{HOST}/d/{DATASET}"
EXPORT_PATH = f"/api/views/{DATASET}/rows.csv?accessType=DOWNLOAD"
COUNT_PATH = f"/resource/{DATASET}.json?$select=count(*)"
FILE = "ngsim_portal.csv"

TIMEOUT_S = 20.0  # [s] without an answer
RETRIES = 5  # broken connections in a row before giving up
PAUSE_S = 2.0  # [s] before the next try
BLOCK = 1 << 20  # [bytes]


@dataclass(frozen=True)
class Fetched:
    """A complete download.

    Attributes:
        path: where it is.
        size: [bytes].
        rows: without the header.
        expected_rows: what the portal says; None if it did not say.
        resumed_at: bytes that an earlier try had left.
    """

    path: Path
    size: int
    rows: int
    expected_rows: int | None
    resumed_at: int


def advice(out: Path) -> str:
    """Instructions to get the file on another machine and to put it at `out`, for a machine without a network."""
    return (
        f"on a machine that has a network, open {PAGE} (dataset {DATASET}, {TITLE!r}), choose Export and CSV (about "
        f"12 million rows, 1.5 GB), and put the file at {out.absolute()}; then: data convert {out} FOLDER"
    )


def download(out: Path, *, host: str = HOST, progress: bool = False, pause_s: float = PAUSE_S) -> Fetched:
    """Fetch the portal's CSV of all sites to `out`; what an earlier call has left in ``<out>.part`` is continued.

    Args:
        out: file to write; must not exist yet.
        host: scheme and name of the portal.
        progress: show a bar on stderr.
        pause_s: between tries after a broken connection [s].

    Raises:
        InputError: the portal cannot be reached (with what to download by hand, and where to put it), what it sends is
            no NGSIM, or size or number of rows are not what it says.
    """
    if not host.startswith(("https://", "http://")):
        raise InputError(f"host {host!r}: expected it to begin with https:// or http://")
    if out.exists():
        raise InputError(f"{out}: is there already; remove it to fetch it again, or: data info {out}")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        expected = _expected_rows(host)
        transfer = _Transfer(host + EXPORT_PATH, out, progress=progress, pause_s=pause_s)
        resumed_at = transfer.have()
        transfer.run()
        rows = _checked(transfer.part, expected)
        transfer.finish()
    except (urllib.error.URLError, http.client.HTTPException, TimeoutError, ConnectionError) as error:
        reason = getattr(error, "reason", None) or error
        raise InputError(f"{host} cannot be reached or breaks off ({reason}): {advice(out)}") from error
    except OSError as error:
        raise InputError(f"{error.filename or out}: cannot be written: {error.strerror or error}") from error
    return Fetched(out, out.stat().st_size, rows, expected, resumed_at)


def _expected_rows(host: str) -> int | None:
    """How many rows the portal says that there are; None if its answer cannot be understood."""
    with _open(host + COUNT_PATH.replace("(*)", "(%2A)")) as answer:
        try:
            (row,) = json.loads(answer.read(BLOCK))
            return int(next(iter(row.values())))
        except (ValueError, TypeError, AttributeError, StopIteration):
            return None


def _open(url: str, headers: dict[str, str] | None = None) -> Any:
    request = urllib.request.Request(url, headers={"User-Agent": "LitSim-ROS", **(headers or {})})  # noqa: S310  checked
    return urllib.request.urlopen(request, timeout=TIMEOUT_S)  # noqa: S310  the scheme is checked by `download`


class _Transfer:
    """The bytes of one address into a ``.part`` file, over as many connections as it takes."""

    def __init__(self, url: str, out: Path, *, progress: bool, pause_s: float) -> None:
        self.url, self.out, self.progress, self.pause_s = url, out, progress, pause_s
        self.part = out.with_name(out.name + ".part")
        self.about = out.with_name(out.name + ".part.json")
        self.total: int | None = None

    def have(self) -> int:
        """Number of bytes of the file that have been fetched already."""
        return self.part.stat().st_size if self.part.is_file() else 0

    def finish(self) -> None:
        self.part.replace(self.out)
        self.about.unlink(missing_ok=True)

    def run(self) -> None:
        """Fetch what is left of the file, over as many connections as it takes."""
        broken = 0
        with tqdm(unit="B", unit_scale=True, desc=self.out.name, disable=not self.progress) as bar:
            while not self._once(bar):
                broken += 1
                if broken > RETRIES:
                    raise ConnectionError(f"{RETRIES + 1} connections broke off, {self.have()} bytes are kept")
                time.sleep(self.pause_s)

    def _once(self, bar: tqdm[Any]) -> bool:
        """One connection; whether the file is whole after it."""
        have = self.have()
        headers = {}
        if have:
            headers["Range"] = f"bytes={have}-"
            if version := self._version():
                headers["If-Range"] = version
        try:
            answer = _open(self.url, headers)
        except urllib.error.HTTPError as error:
            if error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE and have:  # it is whole, or has changed
                said = (error.headers.get("Content-Range") or "").rpartition("/")[2]
                if said == str(have):
                    return True
                self.part.unlink()
                return False
            raise
        with answer:
            resumed = answer.status == http.client.PARTIAL_CONTENT
            if have and not resumed:
                bar.write(f"the portal does not continue at byte {have}: from the beginning")
            begin = have if resumed else 0
            length = answer.headers.get("Content-Length")
            self.total = begin + int(length) if length else None
            self._remember(answer.headers.get("ETag") or answer.headers.get("Last-Modified") or "")
            bar.total, bar.n = self.total, begin
            bar.refresh()
            with self.part.open("ab" if resumed else "wb") as file:
                try:
                    while data := answer.read(BLOCK):
                        file.write(data)
                        bar.update(len(data))
                except (http.client.IncompleteRead, TimeoutError, ConnectionError) as error:
                    if isinstance(error, http.client.IncompleteRead):
                        file.write(error.partial)
                    return False
        return self.total is None or self.have() >= self.total

    def _version(self) -> str:
        """What the portal called the version that the first bytes are of."""
        try:
            return str(json.loads(self.about.read_text(encoding="utf-8"))["version"])
        except (OSError, ValueError, KeyError, TypeError):
            return ""

    def _remember(self, version: str) -> None:
        self.about.write_text(json.dumps({"url": self.url, "version": version}), encoding="utf-8")


def _checked(path: Path, expected: int | None) -> int:
    """The number of rows, if that is NGSIM and all of it."""
    layout = ngsim_format.detect(path)
    if layout is None:
        with path.open("rb") as file:
            head = file.read(80)
        path.unlink()
        raise InputError(f"{path}: what the portal sent is no NGSIM file, it begins with {head!r}; {advice(path)}")
    lines, last = 0, b"\n"
    with path.open("rb") as file:
        file.seek(layout.start)
        while data := file.read(16 * BLOCK):
            lines, last = lines + data.count(b"\n"), data[-1:]
    rows = lines + (last != b"\n")
    if expected is not None and rows != expected:
        raise InputError(
            f"{path}: {rows} rows, but the portal says {expected}: run it again to fetch what is missing; if that "
            f"changes nothing, remove this file and begin anew"
        )
    return rows
