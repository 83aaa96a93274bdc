"""`--ego autoware` in launches and campaigns: an external ego, which the adapter's program starts."""

import pytest

from litsim_eval.campaign.suite import EgoSetup
from litsim_sim.cli.launch import parser
from litsim_sim.launch.adapters import adapter_names, adapter_of
from litsim_sim.scenario.run_info import EXTERNAL


def test_the_adapters_are_installed() -> None:
    assert adapter_names() == ("autoware", "autoware_universe")
    assert adapter_of("idm") is None
    arguments = parser().parse_args(["--ego", "autoware", "--", "ros2", "launch", "--help"])
    assert (arguments.ego, arguments.command) == ("autoware", ["ros2", "launch", "--help"])


@pytest.mark.parametrize(("name", "profile"), [("autoware", "core"), ("autoware_universe", "universe")])
def test_the_command_starts_the_stack_after_the_adapter(name: str, profile: str) -> None:
    adapter = adapter_of(name)
    assert adapter is not None
    program, *words = adapter.command(["ros2", "launch"])
    assert program.endswith("litsim_autoware/lib/litsim_autoware/autoware")
    assert words == ["--profile", profile, "--", "ros2", "launch"]
    assert adapter.command([])[1:] == ["--profile", profile]


def test_a_campaign_has_it_as_an_external_ego_of_its_own_name() -> None:
    setup = EgoSetup.model_validate({"kind": "autoware", "command": ["ros2"]})
    assert (setup.name, setup.kind, setup.adapter) == ("autoware", EXTERNAL, "autoware")
    assert EgoSetup.model_validate(setup.model_dump()) == setup
    assert "adapter" not in EgoSetup(name="idm", kind="idm").model_dump(mode="json")
