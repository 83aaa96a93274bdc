"""Which runs a suite makes, and by what each is known again."""

import json
from pathlib import Path
from typing import Any

import pytest

from campaigns import DEMO, EGO, VERSIONS, cases, scenario_file, suite
from litsim_eval.campaign.case import Case, cases_of
from litsim_eval.campaign.suite import Suite
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import Scenario


def one(**values: Any) -> Case:
    (case,) = cases(**({"policies": ["litsim"]} | values))
    return case


def test_every_ego_policy_seed_and_value_is_a_case() -> None:
    made = cases(egos=["idm", "log"], seeds=[1, 2], parameters={"conflict.horizon": [2.0, 3.0]})
    assert [case.name for case in made] == [
        f"demo/{EGO}/{ego}/{variant[0]}/{seed}{variant[1]}"
        for ego in ("idm", "log")
        for variant in (("replay", ""), ("litsim", ", horizon=2.0"), ("litsim", ", horizon=3.0"))
        for seed in (1, 2)
    ]
    assert len({case.id for case in made}) == len({case.key for case in made}) == len(made)
    assert [case.variant for case in made][::2] == [
        f"{ego}, {variant}"
        for ego in ("idm", "log")
        for variant in ("replay", "litsim, horizon=2.0", "litsim, horizon=3.0")
    ]


def test_a_model_is_named_by_its_value_alone() -> None:
    assert one(parameters={"predictor.model": ["kinematic"]}).label == "kinematic"


@pytest.mark.parametrize("choice", ["egos", "ego", "all", [1, 3]])
def test_which_vehicles_are_the_ego(choice: Any) -> None:
    demo = Scenario.load("demo")
    wanted = {"egos": demo.egos, "ego": (demo.ego_id,), "all": demo.possible_egos}
    found = cases(cases=[{"scenario": "demo", "ego_id": choice}], policies=["litsim"])
    assert tuple(case.ego_id for case in found) == (wanted[choice] if isinstance(choice, str) else (1, 3))


def test_an_entry_that_cannot_be_used_is_told_by_file_line_and_field(tmp_path: Path) -> None:
    inner, outer = tmp_path / "inner.yaml", tmp_path / "outer.yaml"
    inner.write_text(
        "name: inner\negos: [idm]\ncases:\n  - {scenario: demo, ego_id: ego}\n  - {scenario: demo, ego_id: 99}\n"
    )
    outer.write_text("name: outer\negos: [idm]\ninclude: [inner.yaml]\ncases:\n  - {scenario: none.yaml}\n")
    with pytest.raises(InputError) as found:
        cases_of(Suite.load(outer), with_versions=VERSIONS)
    assert str(found.value).startswith(f"{inner}: line 5, field cases.1: ego_id: 99 not there at the start of demo")
    inner.write_text(inner.read_text().replace("ego_id: 99", "ego_id: 7"))
    with pytest.raises(InputError) as found:
        cases_of(Suite.load(outer), with_versions=VERSIONS)
    assert str(found.value).startswith(f"{outer}: line 5, field cases.0: {tmp_path / 'none.yaml'}")


def test_a_scenario_without_egos_for_tuning() -> None:
    with pytest.raises(InputError, match="field tuning of the scenario lists no egos"):
        cases(cases=[{"scenario": "demo", "ego_id": "tuning"}])


def test_the_same_run_asked_for_twice_is_one_case() -> None:
    entries = [
        {"scenario": "demo", "ego_id": 1, "tags": ["a"], "events": [{"kind": "cut_in"}]},
        {"scenario": "demo", "ego_id": 1, "tags": ["a", "b"], "events": [{"kind": "cut_in"}, {"kind": "merge"}]},
    ]
    case = one(cases=entries)
    assert case.tags == ("a", "b")
    assert case.events == ({"kind": "cut_in"}, {"kind": "merge"})


def test_json_keeps_a_case() -> None:
    ego = {"name": "mine", "kind": "external", "command": ["python3", "mine.py"], "ready_s": 3.0}
    case = one(egos=[ego], seeds=[3], parameters={"conflict.horizon": [2.0]}, end_after_contact_s=0.5)
    assert Case.from_json(json.loads(json.dumps(case.to_json()))) == case
    assert case.execution_mode == "graph"


def test_equal_runs_have_equal_ids_wherever_their_files_lie(tmp_path: Path) -> None:
    there = [one(cases=[{"scenario": scenario_file(tmp_path / at), "ego_id": 1}]) for at in ("a", "b")]
    assert there[0].id == there[1].id and there[0].scenario != there[1].scenario


def test_the_scenarios_seed_is_the_same_as_that_seed_given() -> None:
    given = one(seeds=[Scenario.load("demo").seed])
    assert given.id == one().id


def test_the_end_of_runs_is_the_scenarios_unless_one_is_given(tmp_path: Path) -> None:
    at_once = one(end_after_contact_s=0.0)
    assert (at_once.end_after_contact_s, one().end_after_contact_s) == (0.0, None)
    assert at_once.id != one().id and at_once.key != one().key
    of_the_scenario = [{"scenario": scenario_file(tmp_path, end_after_contact_s=0.0), "ego_id": 1}]
    usual = [{"scenario": scenario_file(tmp_path / "usual"), "ego_id": 1}]
    assert one(cases=of_the_scenario).id == one(cases=usual, end_after_contact_s=0.0).id


def test_a_case_of_before_runs_could_end_by_contact_is_read() -> None:
    told = one().to_json()
    del told["end_after_contact_s"]
    assert Case.from_json(told) == one()


def test_whole_numbers_are_equal_to_those_with_a_point() -> None:
    horizons = [one(parameters={"conflict.horizon": [value]}) for value in (2, 2.0)]
    assert horizons[0].id == horizons[1].id


def test_more_values_to_try_leave_the_runs_of_the_others_what_they_were() -> None:
    few, many = (cases(policies=["litsim"], parameters={"conflict.horizon": each}) for each in ([2.0], [2.0, 3.0]))
    assert [case.id for case in few] == [case.id for case in many][:1]
    assert (few[0].name, many[0].name) == (f"demo/{EGO}/idm/litsim", f"demo/{EGO}/idm/litsim, horizon=2.0")


@pytest.mark.parametrize(
    "other",
    [
        {"cases": [{"scenario": "demo", "ego_id": 1}]},
        {"egos": ["log"]},
        {"policies": ["replay"]},
        {"seeds": [77]},
        {"parameters": {"conflict.horizon": [1.5]}},
    ],
)
def test_another_run_has_another_id_and_is_compared_with_another(other: dict[str, Any]) -> None:
    assert one(**other).id != one().id
    assert one(**other).key != one().key


def test_another_recording_is_another_run(tmp_path: Path) -> None:
    path = scenario_file(tmp_path)
    before = one(cases=[{"scenario": path, "ego_id": 1}])
    recording = Scenario.load(path).recording
    changed = recording.table.copy()
    changed.loc[0, "speed"] += 0.5
    Recording.of_table(recording.header, changed).write(tmp_path / DEMO["recording"])
    after = one(cases=[{"scenario": path, "ego_id": 1}])
    assert after.id != before.id and after.key != before.key


def test_another_length_of_the_run_is_another_run(tmp_path: Path) -> None:
    ids = {
        one(cases=[{"scenario": scenario_file(tmp_path / str(s), simulation_s=s), "ego_id": 1}]).id for s in (3.0, 4.0)
    }
    assert len(ids) == 2


def test_versions_change_the_id_and_not_the_key() -> None:
    some = suite(policies=["litsim"])
    now, later = (cases_of(some, with_versions=VERSIONS | {"sources": each})[0] for each in ("b", "c"))
    assert now.id != later.id and now.key == later.key
    (elsewhere,) = cases_of(some, with_versions=VERSIONS | {"commit": "another"})
    assert elsewhere.id == now.id


def test_an_ego_made_otherwise_is_compared_with_the_one_of_its_name() -> None:
    made = [{"name": "mine", "kind": "perturbed", "parameters": {"ego.kind": kind}} for kind in ("brake", "keep_speed")]
    first, second = (one(egos=[ego]) for ego in made)
    assert first.id != second.id and first.key == second.key


def test_a_changed_script_of_the_command_or_module_beside_it_is_another_run(tmp_path: Path) -> None:
    script = tmp_path / "ads.py"
    ids = set()
    for text in ("a = 1", "a = 22"):
        script.write_text(text)
        ids.add(one(egos=[{"name": "mine", "kind": "external", "command": ["python3", str(script)]}]).id)
    (tmp_path / "planner.py").write_text("a module that it may import")
    ids.add(one(egos=[{"name": "mine", "kind": "external", "command": ["python3", str(script)]}]).id)
    assert len(ids) == 3


def test_two_scenarios_of_one_name(tmp_path: Path) -> None:
    entries = [{"scenario": scenario_file(tmp_path / at), "ego_id": 1} for at in ("a", "b")]
    with pytest.raises(InputError, match="are all called own"):
        cases(cases=entries)


def test_graph_or_not_is_part_of_the_run() -> None:
    some = suite(policies=["litsim"])
    ids = {cases_of(some, graph=graph, with_versions=VERSIONS)[0].id for graph in (False, True)}
    assert len(ids) == 2


def test_a_setup_makes_a_variant_with_its_parameters() -> None:
    near = {"name": "near", "kind": "litsim", "parameters": {"conflict.roi_m": 15.0}}
    made = cases(policies=["replay", "litsim", near], parameters={"conflict.horizon": [2.0]})
    assert [case.variant for case in made] == ["idm, replay", "idm, litsim", "idm, litsim, near"]
    assert dict(made[2].parameters) == {"conflict.roi_m": 15.0, "conflict.horizon": 2.0}
    assert made[2].policy == "litsim" and len({case.id for case in made}) == 3


def test_a_variant_tells_which_of_its_own_parameters_the_suite_replaces() -> None:
    """A variant named for a long horizon was run with another one, and nothing said so."""
    long = {"name": "long", "kind": "litsim", "parameters": {"conflict.horizon": 5.0, "conflict.passing": False}}
    ego = {"name": "mine", "kind": "perturbed", "parameters": {"ego.kind": "brake"}}
    replaced = {"conflict.horizon": [2.0], "ego.kind": ["lane_change"]}
    (found,) = cases(policies=[long], egos=[ego], parameters=replaced)
    assert found.variant == "mine, litsim, long, horizon=2.0, kind=lane_change"
    (same,) = cases(policies=[long], egos=[ego], parameters={"conflict.horizon": [5.0], "ego.kind": ["brake"]})
    assert same.variant == "mine, litsim, long"


@pytest.mark.parametrize(
    ("policies", "parameters", "variants"),
    [
        (
            ["litsim", {"name": "long", "kind": "litsim", "parameters": {"conflict.horizon": 5.0}}],
            [2.0],
            "long, horizon",
        ),
        ([{"name": each, "kind": "yield"} for each in "ab"], [2.0, 3.0], "b, horizon=2.0"),
    ],
)
def test_two_variants_of_the_same_runs_are_refused(policies: list[Any], parameters: list[float], variants: str) -> None:
    """The second would be missing from every table without a word."""
    with pytest.raises(InputError, match=f"suite some: variants .* and .*{variants}.* ask for the same runs"):
        cases(policies=policies, parameters={"conflict.horizon": parameters})


def test_an_entry_may_name_its_seed() -> None:
    (case,) = cases(cases=[{"scenario": "demo", "ego_id": 7, "seed": 3}], policies=["litsim"])
    assert case.seed == 3 and case.name == "demo/7/idm/litsim/3"
    (other,) = cases(cases=[{"scenario": "demo", "ego_id": 7, "seed": 3}], policies=["litsim"], seeds=[4])
    assert other.seed == 4
