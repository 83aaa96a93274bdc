"""HTML pages from the templates in `templates`: every value is escaped, all but the style and scripts in `assets`."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from litsim_eval.report.wording import NOTHING, branches, is_nested, leaf


def render_page(template: str, **values: Any) -> str:
    """Returns a page of LitSim as HTML: the file `template` with `values` for its names, in which text is escaped.

    Raises:
        jinja2.UndefinedError: the template names a value that is not given.
    """
    return _environment().get_template(template).render(values)


def render_text(template: str, **values: Any) -> str:
    """Returns a text that is no page, such as Markdown, as :func:`render_page` does, without escapes."""
    return _environment().overlay(autoescape=False).get_template(template).render(values)


def asset(name: str) -> Markup:
    """Returns the text of a file in `assets`: style or script of our own, which goes into a page as it is."""
    return Markup((files("litsim_eval.report") / "assets" / name).read_text(encoding="utf-8"))  # noqa: S704  no data


def compile_templates() -> None:
    """Compiles all templates, for the copies of this process."""
    for name in _environment().list_templates():
        _environment().get_template(name)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("litsim_eval.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals.update(asset=asset, NOTHING=NOTHING)
    environment.filters.update(branches=branches, leaf=leaf)
    environment.tests["nested"] = is_nested
    return environment
