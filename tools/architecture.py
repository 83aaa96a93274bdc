"""Draws the imports between folders into ARCHITECTURE.md, from the code alone.

    PYTHONPATH=$(printf '%s:' src/litsim_*) python tools/architecture.py [--check]

The part of ARCHITECTURE.md between the marks is written anew; --check only says whether that would change it.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import grimp
import networkx as nx

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "ARCHITECTURE.md"
PACKAGES = (
    "litsim_research",
    "litsim_eval",
    "litsim_autoware",
    "litsim_data",
    "litsim_policy",
    "litsim_predictor",
    "litsim_sim",
)  # upper first
BEGIN, END = "<!-- begin: tools/architecture.py -->", "<!-- end: tools/architecture.py -->"


@dataclass
class Folder:
    """A folder of a package, or a module that lies beside its folders.

    Attributes:
        name: dotted name.
        purpose: first sentence of its docstring.
        imports: names of the folders that it imports.
    """

    name: str
    purpose: str
    imports: set[str] = field(default_factory=set)

    @property
    def short(self) -> str:
        """The name within its package."""
        return self.name.partition(".")[2]


def source(module: str) -> Path:
    """Returns the file of a module."""
    path = ROOT / "src" / module.partition(".")[0] / Path(*module.split("."))
    return path / "__init__.py" if (path / "__init__.py").exists() else path.with_suffix(".py")


def read_folders() -> dict[str, Folder]:
    """Returns every folder by name, with what it imports."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    folders: dict[str, Folder] = {}
    folder_of: dict[str, str] = {}
    for module in sorted(graph.modules - set(PACKAGES)):
        name = ".".join(module.split(".")[:2])
        if name not in folders:
            text = ast.get_docstring(ast.parse(source(name).read_text(encoding="utf-8"))) or ""
            folders[name] = Folder(name, text.partition("\n\n")[0].replace("\n", " "))
        folder_of[module] = name
    for module, name in folder_of.items():
        imported = graph.find_modules_directly_imported_by(module)
        folders[name].imports |= {folder_of[other] for other in imported if other in folder_of} - {name}
    return folders


def levels(folders: dict[str, Folder]) -> dict[str, int]:
    """Returns the level of each folder: 1 if it imports no other, else one above the highest that it imports.

    Raises:
        SystemExit: folders import each other in a circle, so there are no levels.
    """
    graph = nx.DiGraph([(folder.name, other) for folder in folders.values() for other in folder.imports])
    graph.add_nodes_from(folders)
    try:
        order = list(nx.topological_sort(graph))
    except nx.NetworkXUnfeasible:
        circle = " -> ".join(edge[0] for edge in nx.find_cycle(graph))
        sys.exit(f"error: folders import each other in a circle: {circle}")
    level: dict[str, int] = {}
    for name in reversed(order):
        level[name] = 1 + max((level[other] for other in folders[name].imports), default=0)
    return level


def figure(imports: Iterable[tuple[str, str]], labels: Mapping[str, str]) -> Iterator[str]:
    """Yields pairs of importer and imported as a Mermaid graph, without imports that follow from others.

    Args:
        imports: pairs of names.
        labels: what is written in the box of each name.
    """
    graph = nx.DiGraph(imports)
    graph.add_nodes_from(labels)
    yield from ("```mermaid", "flowchart TD")
    yield from (f"  {name}[{label}]" for name, label in labels.items())
    yield from (f"  {a} --> {b}" for a, b in sorted(nx.transitive_reduction(graph).edges))
    yield "```"


def arrows(lines: Iterable[str]) -> int:
    """Returns the number of arrows in figures."""
    return sum(" --> " in line for line in lines)


def package_of(folder: str) -> str:
    """Returns the package of a folder."""
    return folder.partition(".")[0]


def table(package: str, folders: dict[str, Folder], level: dict[str, int]) -> Iterator[str]:
    """Yields the folders of a package from the top level down, with all that they import."""
    yield "| folder | purpose | imports |"
    yield "|---|---|---|"
    mine = [folder for folder in folders.values() if package_of(folder.name) == package]
    for folder in sorted(mine, key=lambda folder: (-level[folder.name], folder.name)):
        inside = sorted(folders[name].short for name in folder.imports if package_of(name) == package)
        outside = sorted({package_of(name) for name in folder.imports} - {package})
        imports = ", ".join([*inside, *(f"*{name}*" for name in outside)])
        yield f"| {folder.short} | {folder.purpose} | {imports} |"


def drawing() -> str:
    """Returns the generated part of the page."""
    folders = read_folders()
    level = levels(folders)
    imports = [(folder.name, other) for folder in folders.values() for other in folder.imports]
    between = {(package_of(a), package_of(b)) for a, b in imports if package_of(a) != package_of(b)}
    whole = list(figure(between, {package: package for package in PACKAGES}))
    parts = []
    for package in PACKAGES:
        mine = {folder.name: folder.short for folder in folders.values() if package_of(folder.name) == package}
        inside = [(a, b) for a, b in imports if a in mine and b in mine]
        parts += ["", f"### {package}", "", *figure(inside, mine), "", *table(package, folders, level)]
    drawn = f"{arrows(whole)} arrows between packages and {arrows(parts)} between folders of one package are drawn"
    return "\n".join(
        [
            f"{len(folders)} folders and modules beside them, with {len(imports)} imports between them, none upwards.",
            f"{drawn}; imports that others imply are left out.",
            "",
            *whole,
            *parts,
        ]
    )


def page(part: str) -> str:
    """Returns ARCHITECTURE.md with `part` between the marks."""
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n{part}\n{END}{rest.partition(END)[2]}"


def main() -> None:
    """Write the page, or check it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="exit with status 1 where the page does not show the code")
    check, text = parser.parse_args().check, page(drawing())
    if not check:
        PAGE.write_text(text, encoding="utf-8")
    elif text != PAGE.read_text(encoding="utf-8"):
        sys.exit(f"error: {PAGE.name} does not show the imports of the code; run `make architecture`")


if __name__ == "__main__":
    main()
