"""The code of docs/extending.md is that of the example package."""

import re

from documentation import ROOT

PAGE, EXAMPLE = ROOT / "docs/extending.md", ROOT / "examples/extension"


def test_code_of_the_page_is_that_of_the_package() -> None:
    blocks = re.findall(r"```(?:python|toml|yaml)\n(.*?)```", PAGE.read_text(), re.DOTALL)
    sources = [path.read_text() for path in (*EXAMPLE.glob("*.toml"), *EXAMPLE.rglob("*.py"), *EXAMPLE.rglob("*.yaml"))]
    assert len(blocks) == 12
    assert all(any(block.strip() in source for source in sources) for block in blocks)
