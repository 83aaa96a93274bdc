"""Links of the documentation, as CommonMark reads them: every file and anchor that they name is there."""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from markdown_it import MarkdownIt
from markdown_it.token import Token

from documentation import PAGES, ROOT

TARGET = {"link_open": "href", "image": "src"}
NO_PART_OF_A_SLUG = re.compile(r"[^\w\- ]")


@cache
def tokens(page: Path) -> tuple[Token, ...]:
    """What a page consists of, tables included."""
    return tuple(MarkdownIt("commonmark").enable("table").parse(page.read_text(encoding="utf-8")))


def targets(page: Path) -> Iterator[str]:
    """Where links and pictures of a page lead to, in order."""
    for block in tokens(page):
        for token in block.children or ():
            if token.type in TARGET:
                yield str(token.attrs[TARGET[token.type]])


@cache
def anchors(page: Path) -> frozenset[str]:
    """Anchors of a page's headings, as GitHub makes them: the second of the same name ends in -1, and so on."""
    found: dict[str, int] = {}
    for before, block in zip(tokens(page), tokens(page)[1:], strict=False):
        if before.type == "heading_open":
            text = "".join(token.content for token in block.children or ())
            slug = NO_PART_OF_A_SLUG.sub("", text.lower()).replace(" ", "-")
            found[slug] = found.get(slug, -1) + 1
            if found[slug]:
                found[f"{slug}-{found[slug]}"] = 0
    return frozenset(found)


def fault(page: Path, target: str) -> str | None:
    """What is wrong with a link of a page; None where it leads somewhere, or out of this repository."""
    parts = urlsplit(target)
    if parts.scheme:
        return None
    file = (page.parent / unquote(parts.path)).resolve() if parts.path else page
    if not file.exists():
        return f"{page.name}: {target}: there is no such file"
    if parts.fragment and unquote(parts.fragment) not in anchors(file):
        return f"{page.name}: {target}: no heading of {file.name} has this anchor"
    return None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    faults = [found for target in targets(page) if (found := fault(page, target))]
    assert not faults


def test_faults_are_found(tmp_path: Path) -> None:
    other = tmp_path / "other.md"
    other.write_text("# A *title*, `code` & more\n## Twice\n## Twice\n")
    page = tmp_path / "page.md"
    page.write_text(
        "# Here\n\n[a](other.md#a-title-code--more) [b](other.md#twice-1) [c](#here) [d](https://example.org/#no)\n\n"
        "| table |\n|---|\n| [e](other.md#twice-2) |\n\n- ![f](none.png)\n- [g](#there)\n\n`[code](none.md)`\n"
    )
    faults = [found for target in targets(page) if (found := fault(page, target))]
    assert [text.split(": ")[1] for text in faults] == ["other.md#twice-2", "none.png", "#there"]


def test_readme_leads_to_every_page() -> None:
    readme = ROOT / "README.md"
    linked = {(ROOT / urlsplit(target).path).resolve() for target in targets(readme)}
    assert set(PAGES) - linked == {readme}


def test_pages_that_the_code_names_are_there() -> None:
    files = [file for kind in ("py", "yaml", "msg") for file in (ROOT / "src").rglob(f"*.{kind}")]
    named = {name for file in files for name in re.findall(r"docs/[\w-]+\.md", file.read_text(encoding="utf-8"))}
    assert named
    assert {name for name in named if not (ROOT / name).is_file()} == set()
