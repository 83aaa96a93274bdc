"""What people are told to type exists where they are: in a workspace, and in an installation by pip."""

from importlib import metadata

import pytest

from litsim_sim.core import installation

REQUIRED = ["numpy<3", 'torch==2.13.0; extra == "train"', 'eclipse-sumo==1.28.0; extra == "maps"']


@pytest.fixture
def by_pip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LITSIM", raising=False)
    monkeypatch.setattr(metadata, "requires", lambda _: REQUIRED)


def test_in_a_workspace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LITSIM", "../litsim")
    assert installation.command() == "../litsim"
    monkeypatch.delenv("LITSIM")
    assert (installation.command(), installation.installs("torch")) == ("./litsim", "make setup-all")


@pytest.mark.usefixtures("by_pip")
@pytest.mark.parametrize(("package", "words"), [("torch", "'litsim-ros[train]'"), ("websockets", "websockets")])
def test_by_pip(package: str, words: str) -> None:
    assert (installation.command(), installation.installs(package)) == ("litsim", f"pip install {words}")
