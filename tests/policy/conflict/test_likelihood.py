"""How likely logs are: who is judged, and behind whom a log becomes unlikely."""

import numpy as np
import pytest

from litsim_policy.conflict.detector import Conflict
from litsim_policy.conflict.likelihood import AHEAD, LogLikelihood, LogRatios, unlikely_logs, with_changed
from litsim_sim.core.scene import AgentTable, Controller
from litsim_sim.core.takeover import TakeoverReason

EGO, FOLLOWER = 1, 2
NOW = 30


@pytest.fixture
def scenario(make_scenario, track):
    """A follower 15 m behind the ego, bumper to bumper; both keep 10 m/s in the log."""
    return make_scenario(track(EGO, x=119.5), track(FOLLOWER, x=100.0), coverage_min=0.0)


@pytest.fixture
def judge(scenario, placed):
    """Ratios at step NOW, when the ego is `behind` its log by so much [m] and so much slower [m/s], for 0.5 s."""

    def ratios(behind: float = 0.0, slower: float = 0.0, lag: int = 0) -> tuple[LogRatios, AgentTable]:
        likelihood, table = LogLikelihood(scenario.log), None
        for step in range(NOW - 5, NOW + 1):
            table = scenario.log.table(step)
            share = (step - NOW + 5) / 5
            x, speed = table.x[0] - share * behind, table.speed[0] - share * slower
            table = placed(table, EGO, x=float(x), speed=float(speed), controller=Controller.EGO)
            likelihood.observe(table)
        assert table is not None
        lags = np.array([0, lag])
        return likelihood.at(table, lags, table.mask(np.array([FOLLOWER]))), table

    return ratios


def test_behind_an_ego_on_its_log_every_log_is_as_likely_as_it_was(judge) -> None:
    ratios, _ = judge()
    assert ratios.as_recorded.all() and not ratios.ratio.any() and (ratios.leader == -1).all()


def test_the_slower_the_ego_the_less_likely_is_the_log_behind_it(judge) -> None:
    values = [judge(slower, slower)[0].ratio[1] for slower in (0.6, 2.0, 4.0)]
    assert values == sorted(values, reverse=True) and values[-1] < -3.0 < values[0] < 0.0


def test_the_ego_itself_is_not_judged(judge) -> None:
    ratios, _ = judge(4.0, 4.0)
    assert ratios.ratio[0] == 0.0 and ratios.leader.tolist() == [-1, 0]


def test_a_log_with_a_lag_is_judged_behind_a_leader_that_is_on_its_log(judge) -> None:
    assert judge(lag=10)[0].leader.tolist() == [-1, 0]


def test_whoever_pulls_away_makes_no_log_unlikely(judge) -> None:
    assert judge(-4.0, -4.0)[0].ratio[1] >= 0.0


def test_an_unlikely_log_is_a_conflict_with_the_leader_and_its_goal_is_on_the_log(judge, scenario) -> None:
    ratios, table = judge(4.0, 4.0)
    (conflict,) = unlikely_logs(ratios, table, scenario.log, ratios.ratio < -3.0)
    assert (conflict.agent, conflict.opponent, conflict.reason) == (FOLLOWER, EGO, TakeoverReason.UNLIKELY)
    assert conflict.pose[0] == scenario.log.x[1, NOW + AHEAD] and not conflict.urgent


def test_who_enters_a_road_that_was_empty_is_judged(scenario) -> None:
    likelihood, table = LogLikelihood(scenario.log), scenario.log.table(NOW)
    likelihood.observe(AgentTable.empty(NOW - 5))
    likelihood.observe(table)
    assert len(likelihood.at(table, np.zeros(2, np.int64), np.ones(2, np.bool_)).ratio) == 2


@pytest.mark.parametrize(
    ("behind", "lag", "urgent", "remains"),
    [
        (0.0, 0, False, False),
        (0.0, 0, True, False),
        (4.0, 0, True, True),
        (0.0, 10, False, True),
        (4.0, 0, False, True),
    ],
)
def test_what_the_forecast_expects_of_an_ego_on_its_log_is_no_conflict(judge, behind, lag, urgent, remains) -> None:
    ratios, table = judge(behind, lag=lag)
    conflict = Conflict(FOLLOWER, EGO, 2.0, np.zeros(3), 0.5, urgent)
    assert bool(with_changed([conflict], ratios, table)) == remains
