"""Why and when a run is over."""

import pytest

from litsim_sim.core.stages import EndReason, RunEnd


@pytest.mark.parametrize("reason", EndReason)
def test_an_end_is_the_same_after_yaml_and_json(reason: EndReason) -> None:
    end = RunEnd(reason, 12, "out_0")
    assert RunEnd.of_plain(end.plain()) == end
    assert isinstance(end.plain()["reason"], str) and type(end.plain()["reason"]) is str


@pytest.mark.parametrize("fields", [None, {}, {"reason": "tired", "step": 1, "lane": ""}, {"reason": "time"}, 3])
def test_what_is_no_end_is_none(fields: object) -> None:
    assert RunEnd.of_plain(fields) is None


def test_the_sentence_names_the_lane_by_which_the_ego_has_left() -> None:
    assert RunEnd(EndReason.NET_END, 12, "out_0").sentence == "the ego has left the net at its end, by lane out_0"
    assert RunEnd(EndReason.TIME, 12).sentence == "all steps of the scenario are done"
