"""Says which figures of the documentation are older than what decides them.

    python tools/figures.py --check
    python tools/figures.py --stamp PAGE [COMMAND]

Measured figures stand between marks, in any page of docs/ or in README.md:

    <!-- begin: figures COMMAND; inputs: GLOB GLOB ...; digest: HEX -->
    ...
    <!-- end: figures -->

COMMAND makes the figures. The globs, relative to the root of the repository, name the files that decide them: weights,
configurations, scenarios, suites, and the modules that compute the measures. The digest is that of the content of these
files, sorted by path. --check fails, naming page and block, where it is not that of today's files; `make lint` calls
it. Whoever has run the command again, and put its figures into the page, writes the digest with --stamp: those of all
blocks of PAGE, or only of those whose command contains COMMAND.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BEGIN = re.compile(
    r"<!-- begin: figures (?P<command>[^;>]+); inputs: (?P<inputs>[^;>]+?)(?:; digest: (?P<digest>\w*))? -->"
)
ANY_BEGIN, END = "<!-- begin: figures", "<!-- end: figures -->"
LENGTH = 16  # digits of a digest


def pages(root: Path) -> list[Path]:
    """Returns the pages that may have figures."""
    return [root / "README.md", *sorted(root.glob("docs/**/*.md"))]


def digest(root: Path, inputs: str) -> str:
    """Returns the digest of the content of the files that the globs `inputs` match.

    Raises:
        ValueError: a glob matches no file.
    """
    files: set[Path] = set()
    for pattern in inputs.split():
        matched = {path for path in root.glob(pattern) if path.is_file()}
        if not matched:
            raise ValueError(f"inputs: {pattern}: matches no file")
        files |= matched
    content = hashlib.sha256()
    for path in sorted(files, key=lambda path: path.relative_to(root).as_posix()):
        content.update(hashlib.sha256(path.read_bytes()).digest())
    return content.hexdigest()[:LENGTH]


def faults(root: Path, page: Path) -> Iterator[str]:
    """Yields what is wrong with the blocks of a page."""
    text, name = page.read_text(encoding="utf-8"), page.relative_to(root)
    blocks = list(BEGIN.finditer(text))
    if not len(blocks) == text.count(ANY_BEGIN) == text.count(END):
        yield f"{name}: expected as many marks that begin figures and name inputs, as marks that end them"
    for block in blocks:
        try:
            today = digest(root, block["inputs"])
        except ValueError as error:
            yield f"{name}: figures of `{block['command']}`: {error}"
            continue
        if today != block["digest"]:
            yield (
                f"{name}: figures of `{block['command']}`: older than their inputs (digest {block['digest']}, today "
                f"{today}): run the command, then tools/figures.py --stamp {name}"
            )


def stamp(root: Path, page: Path, command: str = "") -> int:
    """Write today's digests into the blocks of `page` whose command contains `command`; returns their number.

    Raises:
        ValueError: a glob matches no file.
    """

    def stamped(block: re.Match[str]) -> str:
        if command not in block["command"]:
            return block[0]
        inputs = block["inputs"]
        return f"<!-- begin: figures {block['command']}; inputs: {inputs}; digest: {digest(root, inputs)} -->"

    text = page.read_text(encoding="utf-8")
    page.write_text(BEGIN.sub(stamped, text), encoding="utf-8")
    return sum(command in block["command"] for block in BEGIN.finditer(text))


def main() -> int:
    """Check all pages, or stamp one; the exit status is 1 where figures are old."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = p.add_mutually_exclusive_group(required=True)
    what.add_argument("--check", action="store_true", help="fail where figures are older than their inputs")
    what.add_argument("--stamp", type=Path, metavar="PAGE", help="write the digests of a page")
    p.add_argument("command", nargs="?", default="", help="with --stamp: only figures whose command contains this")
    arguments = p.parse_args()
    if arguments.stamp:
        try:
            number = stamp(ROOT, arguments.stamp.resolve(), arguments.command)
        except ValueError as error:
            print(f"{arguments.stamp}: {error}", file=sys.stderr)
            return 1
        print(f"{arguments.stamp}: {number} stamped")
        return 0
    wrong = [fault for page in pages(ROOT) for fault in faults(ROOT, page)]
    print("\n".join(wrong), file=sys.stderr, end="\n" if wrong else "")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
