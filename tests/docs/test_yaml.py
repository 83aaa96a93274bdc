"""Files in YAML that the documentation shows can be read as they are."""

import re
from pathlib import Path

import pytest

from documentation import PAGES, ROOT
from litsim_sim.core.errors import InputError
from litsim_sim.io.yaml_input import load_yaml

FENCED = re.compile(r"^```yaml\n(.*?)^```", re.MULTILINE | re.DOTALL)
SHOWN = {page: blocks for page in PAGES if (blocks := FENCED.findall(page.read_text(encoding="utf-8")))}


@pytest.mark.parametrize("page", SHOWN, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_is_shown_is_yaml(page: Path) -> None:
    assert all(load_yaml(block, page.name) is not None for block in SHOWN[page])


def test_lines_that_are_indented_too_far_are_found() -> None:
    (block,) = FENCED.findall("```yaml\na: 1\n  b: 2\n```\n")
    with pytest.raises(InputError, match="malformed YAML"):
        load_yaml(block, "page")
