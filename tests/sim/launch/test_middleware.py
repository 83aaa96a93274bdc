"""Which settings of the middleware nodes run with, and what these settings say."""

import os
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.launch.middleware import (
    ENCLAVE,
    LOG_FOLDERS,
    LOOPBACK,
    NETWORK,
    PEERS,
    PROFILES,
    RANGE,
    SECURITY,
    STRATEGY,
    check_logging,
    check_security,
    enclave_setting,
    middleware_in_use,
    middleware_settings,
)

HERE = {RANGE: "LOCALHOST"}
SPACE = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"


def test_nodes_that_stay_on_this_machine_use_the_loopback_interface_alone() -> None:
    assert middleware_settings(HERE) == {PROFILES[0]: str(LOOPBACK), RANGE: "SYSTEM_DEFAULT"}
    root = ET.parse(LOOPBACK).getroot()
    assert [each.text for each in root.iter(f"{SPACE}type")] == ["UDPv4"]
    assert [each.text for each in root.iter(f"{SPACE}address")] == ["127.0.0.1", "127.0.0.1"]
    assert [each.text for each in root.iter(f"{SPACE}useBuiltinTransports")] == ["false"]


@pytest.mark.parametrize("environment", [{}, {RANGE: "SUBNET"}, HERE | {PEERS: "10.0.0.7"}])
def test_nodes_that_others_may_reach_keep_the_transports_of_the_middleware(environment: dict[str, str]) -> None:
    assert middleware_settings(environment) == {PROFILES[0]: str(NETWORK)}
    assert not list(ET.parse(NETWORK).getroot().iter(f"{SPACE}transport_descriptor"))


@pytest.mark.parametrize(
    "chosen", [{name: "/mine.xml"} for name in PROFILES] + [{"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}]
)
def test_what_the_user_has_chosen_stays(chosen: dict[str, str]) -> None:
    assert middleware_settings(HERE | chosen) == {}


@pytest.mark.parametrize("path", [LOOPBACK, NETWORK])
def test_settings_are_the_defaults_of_every_node(path: Path) -> None:
    """Else nobody would use them, and say nothing."""
    root = ET.parse(path).getroot()
    for kind in ("participant", "data_writer"):
        (profile,) = root.iter(f"{SPACE}{kind}")
        assert profile.attrib["is_default_profile"] == "true"


def test_the_environment_is_as_before_once_the_node_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*PROFILES, PEERS, "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(RANGE, "LOCALHOST")
    with middleware_in_use("check_ads"):
        assert (os.environ[PROFILES[0]], os.environ[RANGE]) == (str(LOOPBACK), "SYSTEM_DEFAULT")
    assert (os.environ.get(PROFILES[0]), os.environ[RANGE]) == (None, "LOCALHOST")


@pytest.mark.parametrize("strategy", [{}, {STRATEGY: "Permissive"}, {STRATEGY: "enforce"}])
def test_security_that_is_asked_for_has_to_be_enforced(strategy: dict[str, str]) -> None:
    with pytest.raises(InputError, match=rf"^{SECURITY} is true, but {STRATEGY} is '.*', expected 'Enforce': "):
        check_security({SECURITY: "true"} | strategy)


@pytest.mark.parametrize(
    "given", [{}, {SECURITY: "false"}, {STRATEGY: "Permissive"}, {SECURITY: "true", STRATEGY: "Enforce"}]
)
def test_security_that_is_enforced_or_not_asked_for_is_fine(given: dict[str, str]) -> None:
    check_security(given)


def test_a_folder_for_logs_of_ros_is_asked_for_by_its_variable() -> None:
    with pytest.raises(InputError, match=r"; set ROS_LOG_DIR to a folder for the logs of ROS$"):
        check_logging({"HOME": "", "PATH": "/bin"})
    for name in LOG_FOLDERS:
        check_logging({name: "/tmp"})


def test_a_secured_program_is_in_the_enclave_of_its_name() -> None:
    assert enclave_setting({SECURITY: "true"}, "bridge", ["bridge", "--ros-args"]) == {ENCLAVE: "/litsim/bridge"}


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({}, []),
        ({SECURITY: "false"}, []),
        ({SECURITY: "true", ENCLAVE: "/mine"}, []),
        ({SECURITY: "true"}, ["--ros-args", "--enclave", "/mine"]),
        ({SECURITY: "true"}, ["--ros-args", "-e", "/mine"]),
    ],
)
def test_an_enclave_that_is_chosen_stays_and_without_security_there_is_none(
    environment: dict[str, str], words: list[str]
) -> None:
    assert enclave_setting(environment, "bridge", words) == {}
