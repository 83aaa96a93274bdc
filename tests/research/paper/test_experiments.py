"""What the experiments run can be run, and an ablation of the ROI leaves the ego's own model as it is."""

from pathlib import Path

import pytest

from litsim_data.traffic.seeds import PAPER
from litsim_eval.campaign.suite import EgoSetup
from litsim_research.paper import roads as roads_module
from litsim_research.paper.experiments import (
    ABLATION,
    CHANGED,
    CONFLICTING,
    EXPERIMENTS,
    Experiment,
)
from litsim_research.paper.roads import missing, roads
from litsim_sim.core.parameters import by_place
from litsim_sim.scenario.policies import PolicySetup, installed_setups, setup_of
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import configured

EVERY = (*installed_setups(), *(row for each in EXPERIMENTS.values() for row in each.policies))


@pytest.mark.parametrize("policy", EVERY, ids=lambda policy: policy if isinstance(policy, str) else policy.name)
def test_every_row_has_parameters_that_its_stages_know(policy: str | PolicySetup) -> None:
    setup = setup_of(policy)
    assert configured("bat", setup.kind, setup.stage_parameters())["ego"] is not None


@pytest.mark.parametrize("ego", CONFLICTING, ids=lambda ego: ego.name)
def test_the_conflicting_egos_have_parameters_that_the_ego_knows(ego: EgoSetup) -> None:
    assert configured(ego.kind, "replay", by_place(ego.parameters.items()))["ego"] is not None


@pytest.mark.parametrize("experiment", EXPERIMENTS.values(), ids=lambda experiment: experiment.name)
def test_replay_is_a_row_of_every_table(experiment: Experiment) -> None:
    assert experiment.policies[0] == "replay"


def test_recorded_roads_are_missing_without_their_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LITSIM_DATA", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert (missing("real"), missing("highway")) == ("", "")
    assert "examples/streets/windows.py is not in this folder" in missing("streets")
    monkeypatch.delenv("LITSIM_DATA")
    assert "LITSIM_DATA is not set" in missing("real") and "LITSIM_DATA is not set" in missing("streets")


def test_the_changes_together_are_the_papers_configuration() -> None:
    _, ours, *taken_back, paper = CHANGED.policies
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
        "highway": [PAPER[0], PAPER[1]],
        "urban": [PAPER[0], PAPER[1]],
    }
    for name, entries in cases.items():
        for entry in entries:
            scenario = Scenario.load(entry.scenario)
            assert entry.tags == [name] and entry.ego_id in scenario.possible_egos
            assert scenario.total_steps - scenario.history_steps == 60


def test_generated_roads_of_other_seeds_are_not_taken_for_those_of_these(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder of an earlier run has what was drawn then."""
    made: list[int] = []

    def write(_: str, count: int, seed: int, folder: Path) -> None:
        made.append(seed)
        folder.mkdir()
        (folder / "manifest.yaml").touch()
        (folder / f"{count}.yaml").touch()

    monkeypatch.setattr(roads_module, "write_segment_set", write)
    first, again, other = (roads_module.generated("urban", 3, seed, tmp_path) for seed in (1, 1, 2))
    assert first == again != other and made == [1, 2]
