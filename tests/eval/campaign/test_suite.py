"""What a suite file may say, and how what it may not say is told."""

import re
from pathlib import Path

import pytest

from litsim_eval.campaign.case import cases_of
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.suite import Suite
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import packaged

GOOD = """
name: some
cases:
  - {scenario: demo, ego_id: 17, tags: [cut_in], events: [{kind: cut_in, time_s: 12.3}]}
  - {scenario: windows/a.yaml, ego_id: all}
egos:
  - idm
  - {name: braker, kind: perturbed, parameters: {ego.kind: brake}}
  - {name: mine, kind: external, command: [python3, mine.py], interface: twist, ready_s: 30}
policies: [replay]
seeds: [1, 2]
parameters: {conflict.horizon: 2.0, predictor.model: [kinematic, default]}
"""


def load(folder: Path, text: str) -> Suite:
    path = folder / "suite.yaml"
    path.write_text(text)
    return Suite.load(path)


def test_fields_are_read(tmp_path: Path) -> None:
    suite = load(tmp_path, GOOD)
    assert [case.ego_id for case in suite.cases] == [17, "all"]
    assert suite.cases[0].events == [{"kind": "cut_in", "time_s": 12.3}]
    assert [ego.name for ego in suite.egos] == ["idm", "braker", "mine"]
    assert suite.egos[1].parameters == {"ego.kind": "brake"}
    assert suite.egos[2].command == ["python3", "mine.py"] and suite.egos[2].ready_s == 30.0
    assert suite.parameters == {"conflict.horizon": [2.0], "predictor.model": ["kinematic", "default"]}


def test_equal_latencies_are_one_however_they_are_written(tmp_path: Path) -> None:
    texts = GOOD.replace("conflict.horizon: 2.0", "bridge.latency: [0.1, '0.10', 1.0, measured]")
    assert load(tmp_path, texts).parameters["bridge.latency"] == ["0.1", "1", "measured"]
    with pytest.raises(InputError, match=r"latency is 0\.25, expected measured, or a multiple"):
        load(tmp_path, texts.replace("'0.10'", "0.25"))


def test_scenarios_are_found_beside_the_suite(tmp_path: Path) -> None:
    suite = load(tmp_path, GOOD)
    assert [case.scenario for case in suite.cases] == ["demo", str(tmp_path / "windows/a.yaml")]


def test_a_pattern_stands_for_all_scenarios_of_such_names(tmp_path: Path) -> None:
    folder = tmp_path / "[of] mine"
    (folder / "windows").mkdir(parents=True)
    for name in ("b_test.yaml", "a_test.yaml", "c_train.yaml", "d[1].yaml", "manifest.yaml"):
        (folder / "windows" / name).touch()
    suite = load(folder, GOOD.replace("windows/a.yaml", "'windows/?_test.yaml'"))
    assert [case.scenario for case in suite.cases[1:]] == [
        str(folder / "windows" / name) for name in ("a_test.yaml", "b_test.yaml")
    ]
    assert all(case.ego_id == "all" for case in suite.cases[1:])
    absolute = load(tmp_path, GOOD.replace("windows/a.yaml", f"'{tmp_path}/*/windows/d*'"))
    literal = load(folder, GOOD.replace("windows/a.yaml", "'windows/d[1].yaml'"))
    assert absolute.cases[1].scenario == literal.cases[1].scenario == str(folder / "windows" / "d[1].yaml")
    with pytest.raises(InputError, match=r"field cases: scenario windows/x\*\.yaml: no file has such a name"):
        load(folder, GOOD.replace("windows/a.yaml", "windows/x*.yaml"))


def test_what_is_left_out_is_the_default(tmp_path: Path) -> None:
    suite = load(tmp_path, "name: some\ncases: [{scenario: demo}]\negos: [idm]")
    assert suite.cases[0].ego_id == "egos"
    assert suite.policies == ["replay", "litsim"]
    assert suite.seeds == [] and suite.parameters == {}
    assert len(suite.criteria.runs) > 0


def test_criteria_from_a_file_beside_the_suite(tmp_path: Path) -> None:
    (tmp_path / "limits.yaml").write_text("runs: [{field: takeovers, max: 3}]")
    suite = load(tmp_path, GOOD + "criteria: limits.yaml")
    assert [criterion.title for criterion in suite.criteria.runs] == ["takeovers at most 3"]


def test_the_packaged_criteria_are_those_of_default(tmp_path: Path) -> None:
    text = packaged("criteria/default.yaml", "litsim_eval").read_text()
    (tmp_path / "copy.yaml").write_text(text)
    assert load(tmp_path, GOOD + "criteria: default").criteria == load(tmp_path, GOOD + "criteria: copy.yaml").criteria


def test_the_cases_of_suites_that_are_included_come_first(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    load(tmp_path / "other", "name: other\ninclude: [small]\ncases: [{scenario: b.yaml}]\negos: [bat]")
    suite = load(tmp_path, GOOD + "include: [other/suite.yaml]")
    small = Suite.load("small").cases
    assert suite.cases[: len(small)] == small
    assert [case.scenario for case in suite.cases[len(small) :]] == [
        str(tmp_path / "other/b.yaml"),
        "demo",
        str(tmp_path / "windows/a.yaml"),
    ]
    assert [ego.name for ego in suite.egos] == ["idm", "braker", "mine"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name: a\negos: [idm]", "neither cases nor include"),
        ("name: a\ninclude: [suite.yaml]\negos: [idm]", "field include: the suite includes itself"),
        (
            "name: a\ninclude: [none.yaml]\negos: [idm]",
            "none.yaml: no such suite, expected a YAML file, the folder of a campaign, or one of",
        ),
    ],
)
def test_what_cannot_be_included(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load(tmp_path, text)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("  - idm", "  - idmm", r"line 7, field egos\.0: expected one of bat, idm, .*found 'idmm'"),
        ("  - idm", "  - braker2: 1", r"line 7, field egos\.0\.name"),
        ("  - idm", "  - {name: braker, kind: idm}", "egos: braker more than once"),
        (
            "  - idm",
            "  - {kind: idm, command: [python3]}",
            "ego idm: command, interface and ready_s belong",
        ),
        (
            "  - idm",
            "  - {kind: external, command: []}",
            r"line 7, field egos\.0: command is empty, expected the words",
        ),
        ("policies: [replay]", "policies: [reply]", r"line 10, field policies\.0"),
        ("policies: [replay]", "policy: [replay]", "field policy: .*known fields: name, description, include, cases"),
        ("ego_id: 17", "ego_id: some", r"line 4, field cases\.0\.ego_id"),
        ("interface: twist", "environment: [A B]", r"line 9, field egos\.2\.environment"),
        ("kind: cut_in, ", "", r"line 4, field cases\.0\.events: .*an event without kind"),
        ("conflict.horizon", "horizon", "line 12, field parameters: .*'horizon', expected STAGE.NAME"),
        ("seeds: [1, 2]", "seeds: [1, 1]", "seeds: 1 more than once"),
        ("seeds: [1, 2]", "seeds: [-1]", r"line 11, field seeds\.0"),
        ("name: some", "name: ''", "line 2, field name"),
        ("interface: twist", "interface: twists", r"line 9, field egos\.2\.interface"),
    ],
)
def test_what_does_not_fit_is_told_by_line_and_field(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert GOOD.count(old) == 1
    with pytest.raises(InputError, match=said):
        load(tmp_path, GOOD.replace(old, new))


def test_what_the_documentation_shows_can_be_used(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "docs/campaigns.md").read_text()
    blocks = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    (shown,) = (block for block in blocks if block.startswith("name: cut_ins"))
    (criteria,) = (block for block in blocks if block.startswith("criteria:"))
    suite = load(tmp_path, re.sub("criteria: default.*\n", criteria, shown))
    assert [ego.name for ego in suite.egos] == ["idm", "late_braker", "mine"]
    assert len(suite.criteria.runs) == 3 and len(suite.criteria.suite) == 2


def test_policies_may_have_setups_of_their_own(tmp_path: Path) -> None:
    own = "policies: [replay, paper, {name: near, kind: litsim, parameters: {conflict.roi_m: 15.0}}]"
    suite = load(tmp_path, GOOD.replace("policies: [replay]", own))
    assert [(setup.name, setup.kind) for setup in suite.setups] == [
        ("replay", "replay"),
        ("paper", "litsim"),
        ("near", "litsim"),
    ]
    assert suite.setups[1].parameters["conflict.region"] == "ego"
    assert suite.setups[2].parameters == {"conflict.roi_m": 15.0}


@pytest.mark.parametrize(
    ("policies", "message"),
    [
        ("[swerve]", "expected one of gail, idm, litsim"),
        ("[{name: near, kind: swerve}]", "kind"),
        ("[{name: near, kind: litsim, parameters: {roi: 1}}]", "expected STAGE.NAME"),
        ("[paper, {name: paper, kind: litsim}]", "paper more than once"),
    ],
)
def test_policies_that_there_are_not(tmp_path: Path, policies: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load(tmp_path, GOOD.replace("policies: [replay]", f"policies: {policies}"))


def test_a_command_is_started_beside_its_suite_with_the_variables_that_it_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MODEL", "small")
    monkeypatch.delenv("DEVICE", raising=False)
    ego = "{name: mine, kind: external, command: [python3, mine.py], environment: [GAIN=2.5, MODEL, DEVICE]}"
    suite = load(tmp_path, f"name: a\ncases: [{{scenario: demo}}]\negos: [{ego}]\n")
    wanted = ["env", "-C", str(tmp_path), "-u", "DEVICE", "GAIN=2.5", "MODEL=small", "python3", "mine.py"]
    assert suite.egos[0].argv == wanted
    with pytest.raises(InputError, match=rf"ego mine: mine.py: no such file in {tmp_path}, expected the script"):
        suite.egos[0].check_command()
    (tmp_path / "mine.py").touch()
    suite.egos[0].check_command()
    with pytest.raises(InputError, match=r"ego mine: \./run.sh: no such program in "):
        suite.egos[0].model_copy(update={"command": ["./run.sh"]}).check_command()


def test_variables_belong_to_the_identity_of_a_case_and_its_folder_does_not(tmp_path: Path) -> None:
    def identity(folder: Path, environment: str) -> str:
        folder.mkdir(exist_ok=True)
        (folder / "mine.py").write_text("drive()")
        ego = f"{{name: mine, kind: external, command: [python3, mine.py], environment: [{environment}]}}"
        suite = load(folder, f"name: a\ncases: [{{scenario: demo, ego_id: ego}}]\negos: [{ego}]\npolicies: [replay]\n")
        return cases_of(suite, with_versions={})[0].id

    same, here, other = (
        identity(tmp_path / "a", "GAIN=1"),
        identity(tmp_path / "b", "GAIN=1"),
        identity(tmp_path, "GAIN=2"),
    )
    assert same == here != other


def test_the_folder_of_a_campaign_is_a_suite(tmp_path: Path) -> None:
    suite = load(tmp_path, "name: a\ncases: [{scenario: demo, ego_id: ego}]\negos: [idm]\n")
    CampaignFolder(tmp_path / "out").begin(suite, cases_of(suite), {})
    assert Suite.load(tmp_path / "out").model_dump() == suite.model_dump()
    (tmp_path / "out/campaign.json").write_text("{}")
    with pytest.raises(InputError, match=r"campaign.json: not a campaign"):
        Suite.load(tmp_path / "out")
