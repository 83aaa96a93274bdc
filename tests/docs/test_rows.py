"""Tables of the documentation: each row has the cells of its head; what is beyond is not shown, without a word."""

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from documentation import PAGES, ROOT

BETWEEN_CELLS = re.compile(r"(?<!\\)\|")


def uneven_rows(text: str) -> Iterator[str]:
    """Rows of the tables of a page that have more or fewer cells than the head of their table."""
    head, fenced = 0, False
    for line in map(str.strip, text.splitlines()):
        fenced ^= line.startswith("```")
        count = 0 if fenced or not line.startswith("|") else len(BETWEEN_CELLS.findall(line)) - 1
        head = (head or count) if count else 0
        if count != head:
            yield line


def rows_outside_tables(text: str) -> list[str]:
    """Returns rows of a page that are shown as text, such as those after an empty line within a table."""
    tokens = MarkdownIt("commonmark").enable("table").parse(text)
    paragraphs = (token for before, token in pairwise(tokens) if before.type == "paragraph_open")
    return [token.content for token in paragraphs if token.content.startswith("|")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_rows_belong_to_a_table(page: Path) -> None:
    assert rows_outside_tables(page.read_text(encoding="utf-8")) == []


def test_rows_outside_tables_are_found() -> None:
    assert rows_outside_tables("| a |\n|---|\n| b |\n\n| lost |\n\n```\n| code\n```\n") == ["| lost |"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_rows_have_the_cells_of_their_head(page: Path) -> None:
    assert list(uneven_rows(page.read_text(encoding="utf-8"))) == []


def test_uneven_rows_are_found() -> None:
    text = "| a | b |\n|---|---|\n| 1 \\| 2 | 3 |\n| short |\n\n```\n| no table\n```\n| c |\n|---|\n| long | er |\n"
    assert list(uneven_rows(text)) == ["| short |", "| long | er |"]
