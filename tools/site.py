"""Lays the pages of the site out in build/site-source, as in the repository, with the files that they link to.

    python tools/site.py

The pages are those of the navigation in zensical.toml, which must have every page of the documentation. A link to a
file that is not there, or to a folder, which a site cannot show, is an error; anchors, and links among pages, are
checked by `zensical build --strict`.
"""

from __future__ import annotations

import re
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "build/site-source"
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.MULTILINE | re.DOTALL)
TARGET = re.compile(r"\]\(([^)\s]+)\)")


def listed(navigation: Any) -> Iterator[Path]:
    """Yields the pages of a navigation, in their order."""
    for title in navigation:
        for entry in title.values():
            if isinstance(entry, str):
                yield Path(entry)
            else:
                yield from listed(entry)


def linked(root: Path, page: Path) -> Iterator[Path]:
    """Yields the files, relative to `root`, that a page links to.

    Raises:
        ValueError: there is no such file in the repository.
    """
    text = CODE.sub("", (root / page).read_text(encoding="utf-8"))
    for target in TARGET.findall(text):
        parts = urlsplit(target)
        if not parts.scheme and parts.path:
            file = (root / page.parent / unquote(parts.path)).resolve()
            if not file.is_file() or not file.is_relative_to(root):
                raise ValueError(f"{page}: {target}: expected a file of the repository")
            yield file.relative_to(root)


def lay_out(root: Path, out: Path) -> None:
    """Copies the pages of the repository at `root`, and what they link to, to the folder `out`.

    Raises:
        ValueError: a link leads nowhere, or a page is not in the navigation.
    """
    pages = list(listed(tomllib.loads((root / "zensical.toml").read_text(encoding="utf-8"))["project"]["nav"]))
    absent = {file.relative_to(root) for file in (*root.glob("*.md"), *root.glob("docs/*.md"))} - set(pages)
    if absent:
        raise ValueError(f"zensical.toml: the navigation lacks {', '.join(map(str, sorted(absent)))}")
    files = {*pages, *(file for page in pages for file in linked(root, page))}
    lost = {file for file in files if file.suffix == ".md"} - set(pages)
    if lost:
        raise ValueError(
            f"zensical.toml: the navigation lacks {', '.join(map(str, sorted(lost)))}, which pages link to"
        )
    shutil.rmtree(out, ignore_errors=True)
    for file in sorted(files):
        (out / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / file, out / file)


if __name__ == "__main__":
    try:
        lay_out(ROOT, OUT)
    except ValueError as error:
        sys.exit(f"error: {error}")
