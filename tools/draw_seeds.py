"""Draws the seeds of the generated traffic that results are reported on, once the code is frozen.

    python tools/draw_seeds.py

They go, with the commit that they are for, to the file that `litsim_data.traffic.seeds` reads. Nobody has seen the
traffic of these seeds, so nothing can have been chosen on it. It is evaluated once, whatever comes out; whoever changes
what decides the results commits that, and draws anew.
"""

from __future__ import annotations

import json
import secrets
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "src/litsim_data/litsim_data/traffic/reported.json"
LOWEST, HIGHEST = 100_000, 999_999  # seeds in use for anything else have fewer digits


def git(*arguments: str) -> str:
    """Returns what a git command says about the repository."""
    return subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


def drawn(commit: str, before: dict[str, object], draws: int = 5) -> dict[str, object]:
    """Returns the content of the file for `commit`: seeds that differ from each other, and from those `before`."""
    used = {number for value in before.values() for number in (value if isinstance(value, list) else [value])}
    seeds: list[int] = []
    while len(seeds) < draws + 2:
        seed = LOWEST + secrets.randbelow(HIGHEST - LOWEST + 1)
        if seed not in used and seed not in seeds:
            seeds.append(seed)
    return {
        "commit": commit,
        "date": datetime.now(UTC).date().isoformat(),
        "paper": seeds[:draws],
        "left_turns": seeds[draws],
        "freeways": seeds[draws + 1],
    }


def main() -> int:
    """Entry point."""
    if git("status", "--porcelain", "--untracked-files=no"):
        print("draw_seeds: there are changes that are not committed, expected a commit to draw for", file=sys.stderr)
        return 1
    content = drawn(git("rev-parse", "HEAD"), json.loads(FILE.read_text(encoding="utf-8")))
    FILE.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(FILE.read_text(encoding="utf-8"), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
