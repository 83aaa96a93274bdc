"""Nobody reacts faster than people do: a time to react, and braking that is built up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from litsim_policy.driving.reaction import HumanReaction, ReactionConfig, reaction_steps
from litsim_policy.driving.registry import make_policy
from litsim_sim.core.scene import AgentTable, ControlSource, ControlTable
from litsim_sim.core.takeover import Takeover, TakeoverReason, TakeoverState, TakeoverTable
from takeovers import takeover

AGENT, DETECTED = 2, 20
AT_ONCE = ReactionConfig(time=0.0, braking_max=8.0, braking_jerk=0.0)


@dataclass
class Brakes:
    """A policy that brakes as hard as it can and steers to the left, whatever happens."""

    acceleration: float = -8.0
    source: ControlSource = ControlSource.GUARDED

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        agents = np.array([t.agent for t in takeovers.takeovers], np.int64)
        count, speed = len(agents), table.speed[table.rows(agents)]
        sources = np.full(count, self.source, np.uint8)
        yaw_rate = np.full(count, 0.1)
        return ControlTable(table.step, agents, np.full(count, self.acceleration), speed * yaw_rate, yaw_rate, sources)


def taken(state: TakeoverState = TakeoverState.HELD, reason: TakeoverReason = TakeoverReason.CONFLICT) -> Takeover:
    path = np.array([[0.0, 0.0], [100.0, 0.0]])
    return takeover(AGENT, state=state, reason=reason, detected_step=DETECTED, reference_path=path)


@pytest.fixture
def scenario(make_scenario, track):
    """Agent 2 gains 0.2 m/s a step in its log."""
    return make_scenario(track(1, x=200.0), track(AGENT, x=50.0, acceleration=2.0))


PEOPLE = ReactionConfig(time=0.75, braking_max=7.59, braking_jerk=12.65)


def act(scenario, config: ReactionConfig, step: int, what: Takeover, policy: Brakes | None = None, before: float = 0.0):
    """Acceleration and source of agent 2 at a step, which accelerated by `before` until then, and its control."""
    table = scenario.log.table(step)
    acceleration = table.acceleration.copy()
    acceleration[table.row(AGENT)] = before
    table = replace(table, acceleration=acceleration)
    controls = HumanReaction(policy or Brakes(), scenario, config).act(table, TakeoverTable(step, (what,)))
    return float(controls.acceleration[0]), controls


def test_until_it_reacts_it_drives_on_as_its_log_did(scenario) -> None:
    log, config = scenario.log, replace(PEOPLE, time=0.7)
    row = log.row(AGENT)
    for step in range(DETECTED, DETECTED + 7):
        acceleration, controls = act(scenario, config, step, taken())
        assert acceleration == pytest.approx((log.speed[row, step + 1] - log.speed[row, step]) / 0.1)
        assert acceleration > 0.0
        assert controls.yaw_rate[0] == controls.lateral_acceleration[0] == 0.0
        assert controls.source[0] == ControlSource.POLICY, "no guard has changed what it does"
    acceleration, controls = act(scenario, config, DETECTED + 7, taken())
    assert acceleration < 0.0 and controls.yaw_rate[0] == 0.1 and controls.source[0] == ControlSource.GUARDED


def test_braking_is_built_up_and_bounded(scenario) -> None:
    config, later = ReactionConfig(braking_max=7.0, braking_jerk=12.0), DETECTED + 20
    assert act(scenario, config, later, taken(), before=1.5)[0] == pytest.approx(-1.2), "off the accelerator at once"
    assert act(scenario, config, later, taken(), before=-3.0)[0] == pytest.approx(-4.2)
    assert act(scenario, config, later, taken(), before=-6.5)[0] == pytest.approx(-7.0)
    gentle = Brakes(acceleration=-1.0)
    assert act(scenario, config, later, taken(), gentle, before=-3.0)[0] == -1.0, "easing off takes no time"


def test_whoever_is_known_already_needs_no_time(scenario) -> None:
    config = replace(PEOPLE, time=1.0, braking_jerk=0.0)
    for what in (taken(TakeoverState.HANDBACK), taken(reason=TakeoverReason.BLOCKED_ENTRY)):
        assert act(scenario, config, DETECTED, what)[0] == pytest.approx(-7.59)


def test_who_follows_a_lagging_log_is_no_business_of_it(scenario) -> None:
    late = taken(TakeoverState.RELEASED)
    assert act(scenario, PEOPLE, DETECTED, late, Brakes(source=ControlSource.LATE))[0] == -8.0


def test_at_once_nothing_is_changed(scenario) -> None:
    table, takeovers = scenario.log.table(DETECTED), TakeoverTable(DETECTED, (taken(),))
    plain, layered = Brakes().act(table, takeovers), HumanReaction(Brakes(), scenario, AT_ONCE).act(table, takeovers)
    for name in ("id", "acceleration", "lateral_acceleration", "yaw_rate", "source"):
        np.testing.assert_array_equal(getattr(layered, name), getattr(plain, name), name)


def test_times_are_drawn_by_seed_and_id_around_their_median() -> None:
    identities = np.array([(seed, agent) for seed in (0, 1) for agent in range(400)])
    steps = reaction_steps(ReactionConfig(time=1.0, spread=0.4), identities)
    assert np.median(steps) == pytest.approx(10, abs=1) and np.ptp(steps) > 10 and steps.min() >= 0
    assert np.std(np.log(steps)) == pytest.approx(0.4, abs=0.05)
    np.testing.assert_array_equal(reaction_steps(ReactionConfig(time=1.0, spread=0.4), identities[300:]), steps[300:])
    assert (steps[:400] != steps[400:]).any()
    assert set(reaction_steps(ReactionConfig(time=0.75), identities).tolist()) == {8}


@pytest.mark.parametrize("name", ["yield", "litsim"])
def test_both_policies_react_as_people_do_and_baselines_do_not(scenario, name: str) -> None:
    assert isinstance(make_policy(name, scenario, {"reaction.time": 0.75}), HumanReaction)
    assert not isinstance(make_policy(name, scenario), HumanReaction)
