"""LitSim from Python: scenarios, simulations, campaigns and recorded runs.

A run of the bundled scenario, and a plot of how many agents were off their logs::

    import matplotlib.pyplot as plt
    from litsim import Scenario, Simulation

    simulation = Simulation(Scenario.load("demo"), ego="perturbed", policy="litsim")
    controlled = []
    while not simulation.ended:
        table = simulation.step()
        controlled.append(table.of_policy.sum())
    plt.plot(controlled)
    plt.xlabel("step [0.1 s]")
    plt.ylabel("agents under control")
    plt.savefig("controlled.png")

A step's agents are arrays: `table.x`, `table.y` [m], `table.yaw` [rad], `table.speed` [m/s], one entry for each id in
`table.id`; see :class:`~litsim_sim.core.scene.AgentTable`. Without `ego`, the caller drives it, by
``simulation.step(EgoCommand(simulation.table.step, acceleration=-1.0))``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import Campaign
from litsim_eval.campaign.suite import Suite
from litsim_eval.runs.campaign import run_suite
from litsim_policy.driving.policy import Policy
from litsim_sim.core.scene import AgentTable, ControlTable, EgoCommand
from litsim_sim.io.yaml_input import validate_yaml
from litsim_sim.record.run import Run, read_run
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation, Step

__all__ = [
    "AgentTable",
    "Campaign",
    "ControlTable",
    "EgoCommand",
    "Policy",
    "Run",
    "Scenario",
    "Simulation",
    "Step",
    "evaluate",
    "load_run",
]


def evaluate(suite: str | Path | Mapping[str, Any], out: str | Path, *, processes: int = 2) -> Campaign:
    """Runs and judges every case of a suite, as `./litsim evaluate --suite` does, and returns the results.

    An interrupted campaign is resumed by the same call. Its `variants` have the results of each ego with each policy,
    and a result has the measures of `metrics.json`::

        campaign = evaluate({"name": "mine", "cases": [{"scenario": "demo"}], "egos": ["idm"]}, "bags/mine")
        for variant, results in campaign.variants.items():
            print(variant, [result.metrics["collision"]["excess"] for result in results])

    Args:
        suite: a packaged name, a YAML file, or its content: `docs/campaigns.md` describes the fields.
        out: folder of the campaign.
        processes: number of runs at a time.

    Raises:
        InputError: the suite cannot be used, a case cannot be run, or the folder holds another campaign.
    """
    loaded = validate_yaml(dict(suite), Suite, "suite", "") if isinstance(suite, Mapping) else Suite.load(suite)
    return run_suite(loaded, CampaignFolder(Path(out)), processes)


def load_run(path: str | Path) -> Run:
    """Returns a run that was recorded to MCAP, from its folder or file; raises InputError if there is none."""
    return read_run(Path(path))
