"""What the experiments run can be run, and an ablation of the ROI leaves the ego's own model as it is."""

from pathlib import Path

import pytest

from litsim_research.paper.experiments import (
    ABLATION,
    ABLATIONS,
    CHANGED,
    DEVIATING,
    DEVIATING_EGO,
    REGIONS,
    TABLE,
)
from litsim_research.paper.roads import roads
from litsim_sim.scenario.policies import PolicySetup, installed_setups, setup_of
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import configured

EXPERIMENTS = (TABLE, ABLATIONS, CHANGED, REGIONS, DEVIATING)
EVERY = (*installed_setups(), *(row for each in EXPERIMENTS for row in each.policies))


@pytest.mark.parametrize("policy", EVERY, ids=lambda policy: policy if isinstance(policy, str) else policy.name)
def test_every_row_has_parameters_that_its_stages_know(policy: str | PolicySetup) -> None:
    setup = setup_of(policy)
    assert configured("bat", setup.kind, setup.stage_parameters())["ego"] is not None


def test_the_deviating_ego_samples_its_manoeuvres(tmp_path: Path) -> None:
    (ego,) = DEVIATING.suite(("highway",), DEVIATING.egos, tmp_path, quick=True).egos
    assert (ego, ego.kind, ego.parameters) == (DEVIATING_EGO, "bat", {"ego.maneuver": "sampled"})


def test_the_changes_together_are_the_papers_configuration() -> None:
    ours, *taken_back, paper = CHANGED.policies
    assert (ours, paper) == ("litsim", "paper")
    parameters = [setup_of(row).parameters for row in taken_back]
    together = {name: value for each in parameters for name, value in each.items()}
    assert together == setup_of("paper").parameters
    assert sum(map(len, parameters)) == len(together), "none is in two rows"


def test_the_ablation_differs_from_the_papers_configuration_in_what_it_ablates() -> None:
    paper = setup_of("paper")
    small = {"predictor.roi_m": 15.0, "conflict.roi_m": 15.0}
    stages = {name: value for name, value in paper.parameters.items() if not name.startswith("policy.")}
    m0, m1, m2, *whole = map(setup_of, ABLATION)
    assert (m0.kind, m0.parameters) == ("yield", stages | small | {"predictor.model": "kinematic"})
    assert (m1.kind, m1.parameters) == ("yield", stages | small)
    assert (m2.kind, m2.parameters) == (paper.kind, paper.parameters | small)
    assert [row.name for row in whole] == ["paper", "litsim"]


def test_quick_roads_are_short_and_have_seeds(tmp_path: Path) -> None:
    cases = roads(("highway", "urban"), tmp_path, quick=True)
    assert {name: [entry.seed for entry in entries] for name, entries in cases.items()} == {
        "highway": [0, 1],
        "urban": [0, 1],
    }
    for name, entries in cases.items():
        for entry in entries:
            scenario = Scenario.load(entry.scenario)
            assert entry.tags == [name] and entry.ego_id in scenario.possible_egos
            assert scenario.total_steps - scenario.history_steps == 60
