"""Survey of scenarios: which can be loaded, and what the others lack."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from litsim_sim.core.errors import InputError, reason
from litsim_sim.scenario.checks import UnmetDemandError
from litsim_sim.scenario.scenario import Scenario, Sources

FILES = "files"  # stands for a file, or a single field, that cannot be used
SHOWN = 10  # most scenarios that :func:`describe` lists


@dataclass(frozen=True)
class Usability:
    """Whether a scenario can be loaded.

    Attributes:
        name: name of the scenario file.
        lacks: unmet demand, a :class:`litsim_sim.scenario.checks.Demand` or :data:`FILES`; empty if it can be loaded.
        why: error of loading; empty likewise.
        coverage: share of the recorded box centres on lanes; None if it cannot be loaded.
    """

    name: str
    lacks: str = ""
    why: str = ""
    coverage: float | None = None


def survey(paths: Iterable[Path], sources: Sequence[Sources | None]) -> list[Usability]:
    """Load the scenario files at `paths`, each with its recording and net from `sources`, if given."""
    results = []
    for path, source in zip(paths, sources, strict=True):
        try:
            results.append(Usability(path.name, coverage=Scenario.load(path, sources=source).coverage))
        except InputError as error:
            lacks = str(error.demand) if isinstance(error, UnmetDemandError) else FILES
            results.append(Usability(path.name, lacks, reason(error)))
    return results


def describe(results: Sequence[Usability]) -> str:
    """Returns a text on how many scenarios can and cannot be loaded, with the errors of the first of the latter."""
    shares = [result.coverage for result in results if result.coverage is not None]
    lacking = [result for result in results if result.lacks]
    range_text = f"; {min(shares):.1%} to {max(shares):.1%} of the box centres on lanes" if shares else ""
    lines = [f"{len(shares)} of {len(results)} scenarios can be loaded{range_text}"]
    lines += [
        f"{count} cannot for their {lacks}" for lacks, count in Counter(result.lacks for result in lacking).items()
    ]
    lines += [f"  {result.why}" for result in lacking[:SHOWN]]
    if len(lacking) > SHOWN:
        lines.append(f"  and {len(lacking) - SHOWN} more")
    return "\n".join(lines)
