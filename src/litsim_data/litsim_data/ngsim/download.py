"""Download of NGSIM from the US DOT's portal: resumable, checked by size and number of rows."""

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

from litsim_data.ngsim import formats as ngsim_format
from litsim_sim.core.errors import InputError

HOST = "https://data.transportation.gov"
DATASET = "8ect-6jqj"
TITLE = "Next Generation Simulation (NGSIM) Vehicle Trajectories and Supporting Data"
PAGE = f"{HOST}/d/{DATASET}"
EXPORT_PATH = f"/api/views/{DATASET}/rows.csv?accessType=DOWNLOAD"
COUNT_PATH = f"/resource/{DATASET}.json?$select=count(*)"
FILE = "ngsim_portal.csv"

TIMEOUT_S = 20.0  # [s] longest wait for data
RETRIES = 5  # retries after broken connections
PAUSE_S = 2.0  # [s] pause before a retry
BLOCK = 1 << 20  # [bytes]


@dataclass(frozen=True)
class Fetched:
    """A complete download.

    Attributes:
        path: the file.
        size: its size [bytes].
        rows: number of rows, without the header.
        expected_rows: number of rows according to the portal; None if unknown.
        resumed_at: bytes that an earlier call had fetched.
    """

    path: Path
    size: int
    rows: int
    expected_rows: int | None
    resumed_at: int


def advice(out: Path) -> str:
    """Instructions to download the file on another machine and to put it at `out`, for machines without a network."""
    return (
        f"on a machine that has a network, open {PAGE} (dataset {DATASET}, {TITLE!r}), choose Export and CSV (about "
        f"12 million rows, 1.5 GB), and put the file at {out.absolute()}; then: data convert {out} FOLDER"
    )


def download(out: Path, *, host: str = HOST, progress: bool = False, pause_s: float = PAUSE_S) -> Fetched:
    """Download the portal's CSV of all sites to `out`, resuming from ``<out>.part`` of an earlier call.

    Args:
        out: file to write; must not exist yet.
        host: scheme and name of the portal.
        progress: show a bar on stderr.
        pause_s: pause before a retry after a broken connection [s].

    Raises:
        InputError: the portal cannot be reached (the message tells how to download by hand), the file is not NGSIM's,
            or its size or number of rows is not that of the portal.
    """
    if not host.startswith(("https://", "http://")):
        raise InputError(f"host {host!r}: expected it to begin with https:// or http://")
    if out.exists():
        raise InputError(f"{out}: exists already; remove it to fetch it again, or: data info {out}")
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
    """Number of rows according to the portal; None if its answer cannot be parsed."""
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
    """Download of one URL to a ``.part`` file."""

    def __init__(self, url: str, out: Path, *, progress: bool, pause_s: float) -> None:
        self.url, self.out, self.progress, self.pause_s = url, out, progress, pause_s
        self.part = out.with_name(out.name + ".part")
        self.about = out.with_name(out.name + ".part.json")
        self.total: int | None = None

    def have(self) -> int:
        """Number of bytes fetched already."""
        return self.part.stat().st_size if self.part.is_file() else 0

    def finish(self) -> None:
        self.part.replace(self.out)
        self.about.unlink(missing_ok=True)

    def run(self) -> None:
        """Fetch the rest of the file, with up to RETRIES retries."""
        broken = 0
        with tqdm(unit="B", unit_scale=True, desc=self.out.name, disable=not self.progress) as bar:
            while not self._once(bar):
                broken += 1
                if broken > RETRIES:
                    raise ConnectionError(f"{RETRIES + 1} connections broke off, {self.have()} bytes are kept")
                time.sleep(self.pause_s)

    def _once(self, bar: tqdm[Any]) -> bool:
        """Fetch over one connection; return whether the file is complete."""
        have = self.have()
        headers = {}
        if have:
            headers["Range"] = f"bytes={have}-"
            if version := self._version():
                headers["If-Range"] = version
        try:
            answer = _open(self.url, headers)
        except urllib.error.HTTPError as error:
            if error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE and have:  # complete, or changed on the portal
                said = (error.headers.get("Content-Range") or "").rpartition("/")[2]
                if said == str(have):
                    return True
                self.part.unlink()
                return False
            raise
        with answer:
            resumed = answer.status == http.client.PARTIAL_CONTENT
            if have and not resumed:
                bar.write(f"the portal does not resume at byte {have}: starting from the beginning")
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
        """The portal's version tag (ETag or date) of the bytes fetched so far; empty if unknown."""
        try:
            return str(json.loads(self.about.read_text(encoding="utf-8"))["version"])
        except (OSError, ValueError, KeyError, TypeError):
            return ""

    def _remember(self, version: str) -> None:
        self.about.write_text(json.dumps({"url": self.url, "version": version}), encoding="utf-8")


def _checked(path: Path, expected: int | None) -> int:
    """The number of rows of the file, after checks that it is NGSIM's and complete."""
    layout = ngsim_format.detect(path)
    if layout is None:
        with path.open("rb") as file:
            head = file.read(80)
        path.unlink()
        raise InputError(f"{path}: the portal sent no NGSIM file: it begins with {head!r}; {advice(path)}")
    lines, last = 0, b"\n"
    with path.open("rb") as file:
        file.seek(layout.start)
        while data := file.read(16 * BLOCK):
            lines, last = lines + data.count(b"\n"), data[-1:]
    rows = lines + (last != b"\n")
    if expected is not None and rows != expected:
        raise InputError(
            f"{path}: {rows} rows, but the portal says {expected}: run it again to fetch the rest; if that changes "
            f"nothing, remove this file and start again"
        )
    return rows
