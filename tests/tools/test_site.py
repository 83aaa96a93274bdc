"""The site: its navigation has every page, links lead to files that it has, and its reference names what there is."""

import re
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

from documentation import PAGES, ROOT
from litsim_sim.core import plugins
from programs import program

REFERENCE = (ROOT / "docs/api.md").read_text(encoding="utf-8")


site = program("tools/site.py")


@pytest.fixture
def pages(tmp_path: Path) -> Path:
    (tmp_path / "zensical.toml").write_text('[project]\nnav = [{ "A" = [{ "B" = "README.md" }] }]\n')
    return tmp_path


def test_every_page_is_on_the_site_with_what_it_links_to(tmp_path: Path) -> None:
    site.lay_out(ROOT, tmp_path)
    assert {tmp_path / page.relative_to(ROOT) for page in PAGES} == set(tmp_path.rglob("*.md"))
    for file in ("examples/minimal_ads.py", "docs/images/takeover.webp"):
        assert (tmp_path / file).read_bytes() == (ROOT / file).read_bytes()


@pytest.mark.parametrize("target", ["none.png", "folder", "../outside.txt"])
def test_a_link_to_no_file_of_the_repository_is_refused(pages: Path, target: str) -> None:
    (pages / "folder").mkdir()
    (pages / "README.md").write_text(f"`[x](code)` [a](https://example.org/) [b](#here)\n![c]({target})\n")
    with pytest.raises(ValueError, match=rf"README.md: {target}: expected a file of the repository"):
        site.lay_out(pages, pages / "out")


def test_a_page_that_the_navigation_lacks_is_refused(pages: Path) -> None:
    (pages / "README.md").write_text("[a](sub/page.md)\n")
    (pages / "sub").mkdir()
    (pages / "sub/page.md").write_text("# Page\n")
    with pytest.raises(ValueError, match=r"the navigation lacks sub/page.md"):
        site.lay_out(pages, pages / "out")
    (pages / "MORE.md").write_text("# More\n")
    with pytest.raises(ValueError, match=r"the navigation lacks MORE.md"):
        site.lay_out(pages, pages / "out")


def test_marks_of_docstrings_become_those_of_markdown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "griffe", SimpleNamespace(Extension=object, Object=object))
    text = "See :class:`~a.b.Policy`, :func:`plan` and :data:`.core.X`, as in::\n\n    f()\n"
    assert program("tools/docstrings.py").markdown(text) == "See `Policy`, `plan` and `core.X`, as in:\n\n    f()\n"


@pytest.mark.parametrize("name", re.findall(r"^::: ([\w.]+)$", REFERENCE, re.MULTILINE))
def test_the_reference_names_what_there_is_and_has_a_docstring(name: str) -> None:
    module, _, attribute = name.rpartition(".")
    if name in sys.modules or name.endswith("quantities"):
        assert import_module(name).__doc__
    else:
        assert getattr(import_module(module), attribute).__doc__


def test_the_reference_has_every_kind_of_plug_in() -> None:
    shown = set(re.findall(r"^### (litsim\.\w+)$", REFERENCE, re.MULTILINE))
    assert shown == {
        *(plugins.POLICIES, plugins.SETUPS, plugins.EGOS, plugins.ADAPTERS, plugins.PREDICTORS, plugins.METRICS),
        *(plugins.MAPS, plugins.SOURCES, plugins.EXPORTS),
    }
