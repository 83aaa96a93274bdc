"""Draws the imports between folders into ARCHITECTURE.md, from the code alone.

    PYTHONPATH=$(printf '%s:' src/litsim_*) python tools/architecture.py [--check | --largest]

Without an option, the part of ARCHITECTURE.md between the marks is written anew; --check says whether that would change
it; --largest prints the largest classes and folders. `make architecture` and `make lint` call the first two.
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
LARGEST = 12  # classes and folders that --largest prints


@dataclass
class Room:
    """A folder of a package, or a module that lies beside its folders.

    Attributes:
        name: dotted name.
        purpose: first sentence of its docstring.
        lines: number of lines of all its modules.
        imports: names of the rooms that it imports.
    """

    name: str
    purpose: str
    lines: int = 0
    imports: set[str] = field(default_factory=set)

    @property
    def short(self) -> str:
        """The name within its package."""
        return self.name.partition(".")[2]


def source(module: str) -> Path:
    """The file of a module."""
    path = ROOT / "src" / module.partition(".")[0] / Path(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def rooms_of_the_house() -> dict[str, Room]:
    """Every room by name, with what it imports."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    rooms: dict[str, Room] = {}
    room_of: dict[str, str] = {}
    for module in sorted(graph.modules - set(PACKAGES)):
        name = ".".join(module.split(".")[:2])
        if name not in rooms:
            text = ast.get_docstring(ast.parse(source(name).read_text(encoding="utf-8"))) or ""
            rooms[name] = Room(name, text.partition("\n\n")[0].replace("\n", " "))
        room_of[module] = name
        rooms[name].lines += len(source(module).read_text(encoding="utf-8").splitlines())
    for module, name in room_of.items():
        found = {room_of[each] for each in graph.find_modules_directly_imported_by(module) if each in room_of}
        rooms[name].imports |= found - {name}
    return rooms


def floors(rooms: dict[str, Room]) -> dict[str, int]:
    """Floor of each room: 1 if it imports no other, else one above the highest that it imports.

    Raises:
        SystemExit: rooms import each other in a circle, so there are no floors.
    """
    graph = nx.DiGraph([(room.name, other) for room in rooms.values() for other in room.imports])
    graph.add_nodes_from(rooms)
    try:
        order = list(nx.topological_sort(graph))
    except nx.NetworkXUnfeasible:
        circle = " -> ".join(edge[0] for edge in nx.find_cycle(graph))
        sys.exit(f"error: folders import each other in a circle: {circle}")
    level: dict[str, int] = {}
    for name in reversed(order):
        level[name] = 1 + max((level[other] for other in rooms[name].imports), default=0)
    return level


def figure(imports: Iterable[tuple[str, str]], labels: Mapping[str, str]) -> Iterator[str]:
    """Pairs of importer and imported as a Mermaid graph; an import that follows from others is not drawn.

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
    """Number of the arrows of figures."""
    return sum(" --> " in line for line in lines)


def package_of(room: str) -> str:
    """The package of a room."""
    return room.partition(".")[0]


def table(package: str, rooms: dict[str, Room], level: dict[str, int]) -> Iterator[str]:
    """The rooms of a package from the top floor down, with all that they import."""
    yield "| folder | purpose | imports |"
    yield "|---|---|---|"
    mine = [room for room in rooms.values() if room.name.startswith(f"{package}.")]
    for room in sorted(mine, key=lambda each: (-level[each.name], each.name)):
        inside = sorted(rooms[each].short for each in room.imports if each.startswith(f"{package}."))
        outside = sorted({each.partition(".")[0] for each in room.imports if not each.startswith(f"{package}.")})
        imports = ", ".join([*inside, *(f"*{each}*" for each in outside)])
        yield f"| {room.short} | {room.purpose} | {imports} |"


def drawing() -> str:
    """The generated part of the page."""
    rooms = rooms_of_the_house()
    level = floors(rooms)
    imports = [(room.name, other) for room in rooms.values() for other in room.imports]
    between = {(package_of(a), package_of(b)) for a, b in imports if package_of(a) != package_of(b)}
    whole = list(figure(between, {package: package for package in PACKAGES}))
    parts = []
    for package in PACKAGES:
        mine = {room.name: room.short for room in rooms.values() if package_of(room.name) == package}
        inside = [(a, b) for a, b in imports if a in mine and b in mine]
        parts += ["", f"### {package}", "", *figure(inside, mine), "", *table(package, rooms, level)]
    drawn = f"{arrows(whole)} arrows between packages and {arrows(parts)} between folders of one package are drawn"
    return "\n".join(
        [
            f"{len(rooms)} folders and modules beside them, with {len(imports)} imports between them, none upwards.",
            f"{drawn}; imports that others imply are left out.",
            "",
            *whole,
            *parts,
        ]
    )


def page(part: str) -> str:
    """ARCHITECTURE.md with `part` between the marks."""
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n{part}\n{END}{rest.partition(END)[2]}"


def print_largest() -> None:
    """The largest classes and folders, in lines."""
    classes = [
        (node.end_lineno - node.lineno + 1, f"{node.name} ({path.relative_to(ROOT / 'src')})")
        for path in (ROOT / "src").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef) and node.end_lineno
    ]
    folders = [(room.lines, room.name) for room in rooms_of_the_house().values()]
    for title, found in (("classes", classes), ("folders", folders)):
        print(f"largest {title}, lines:")
        for lines, name in sorted(found, reverse=True)[:LARGEST]:
            print(f"{lines:6} {name}")


def main() -> None:
    """Write the page, or print what the option asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--check", action="store_true", help="exit with status 1 where the page does not show the code")
    what.add_argument("--largest", action="store_true", help="print the largest classes and folders")
    arguments = parser.parse_args()
    if arguments.largest:
        print_largest()
        return
    text = page(drawing())
    if not arguments.check:
        PAGE.write_text(text, encoding="utf-8")
    elif text != PAGE.read_text(encoding="utf-8"):
        sys.exit(f"error: {PAGE.name} does not show the imports of the code; run `make architecture`")


if __name__ == "__main__":
    main()
