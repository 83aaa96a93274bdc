"""Configuration of a training of the baselines `gail` and `rail`: one YAML file with a section for each part."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from litsim_research.baselines.imitation_policy import Turning
from litsim_research.imitation.critic import WassersteinConfig
from litsim_research.policies.data import DataConfig
from litsim_research.policies.expert import PairsConfig
from litsim_research.policies.ppo import PpoConfig
from litsim_research.policies.warm_start import WarmStart
from litsim_sim.core.quantities import NonNegative, Whole, configuration


@configuration
class ShorterWarmStart(WarmStart):
    """Behaviour cloning by maximum likelihood, which needs fewer epochs."""

    epochs: NonNegative[Whole] = 15


class ImitationTraining(BaseModel):
    """A training run; the YAML file has these fields, those of the parts in sections of their names.

    Attributes:
        seed: of everything random.
        iterations: updates of the policy.
        transitions: least number of agent-steps in an iteration.
        horizon: steps in an episode, fewer if a scenario ends before.
        together: number of scenes that are drawn at a time; those of one kind are stepped together.
        agents: most agents driven in a scene, one number for each of as many equal parts of the iterations.
        radius: distance from the ego within which these agents are chosen [m].
        turning: the yaw rate of action 1: `published`, 0.15 rad/s, for motorways; or `vehicle`, the vehicle's limit,
            with which agents can turn at junctions.
        augmentation: penalty of a step in contact or off the road, in standard deviations of the critic's reward, and
            half of it for hard braking; 0 is GAIL, more is RAIL.
        validate_every: iterations between validations.
        validation_scenes: scenes in a validation.
        error_weight: share of agents at fault that counts as much as a mean error of 1 m [1/m]; the weights with the
            lowest sum of both are kept.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    seed: int = Field(0, ge=0, lt=2**32)
    iterations: int = Field(30, gt=0)
    transitions: int = Field(16_000, gt=0)
    horizon: int = Field(100, gt=0)
    together: int = Field(8, gt=0)
    agents: tuple[int, ...] = Field((10, 20, 40), min_length=1)
    radius: float = Field(60.0, gt=0)
    turning: Turning = "published"
    augmentation: float = Field(0.0, ge=0)
    validate_every: int = Field(5, gt=0)
    validation_scenes: int = Field(12, gt=0)
    error_weight: float = Field(0.05, ge=0)
    data: DataConfig
    drivers: PairsConfig = PairsConfig()
    warm_start: ShorterWarmStart = ShorterWarmStart()
    critic: WassersteinConfig = WassersteinConfig()
    ppo: PpoConfig = PpoConfig(
        learning_rate=1e-4, batch=1000, discount=0.95, imitation_weight=0.0, target_kl=0.015, value_first=5
    )
