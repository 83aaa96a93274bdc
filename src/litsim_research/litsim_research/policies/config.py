"""Configuration of a training of policy C: one YAML file with a section for each part."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_research.policies.critic import CriticConfig
from litsim_research.policies.data import DataConfig
from litsim_research.policies.episodes import EnvironmentConfig
from litsim_research.policies.expert import ExpertConfig
from litsim_research.policies.ppo import PpoConfig
from litsim_research.policies.reward import PenaltyConfig
from litsim_research.policies.task import TaskConfig
from litsim_research.policies.warm_start import WarmStart


class TrainConfig(BaseModel):
    """A training run; the YAML file has these fields, those of the parts in sections of their names.

    Attributes:
        seed: of everything random.
        iterations: updates of the policy.
        transitions: least number of agent-steps in an iteration.
        critic_reward: weight of the critic's reward, which is shifted to mean 0 and scaled down to standard deviation 1
            where it is larger.
        validate_every: iterations between validations.
        validation_episodes: episodes in a validation.
        validate_conflicts: whether only agents that are taken over in conflicts are driven in a validation, behind egos
            that deviate; otherwise as in training.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    seed: int = Field(0, ge=0, lt=2**32)
    iterations: int = Field(200, gt=0)
    transitions: int = Field(3072, gt=0)
    critic_reward: float = Field(0.3, ge=0)
    validate_every: int = Field(20, gt=0)
    validation_episodes: int = Field(20, gt=0)
    validate_conflicts: bool = False
    data: DataConfig
    observation: ObservationConfig = ObservationConfig()
    environment: EnvironmentConfig = EnvironmentConfig()
    penalty: PenaltyConfig = PenaltyConfig()
    task: TaskConfig = TaskConfig()
    expert: ExpertConfig = ExpertConfig()
    warm_start: WarmStart = WarmStart()
    critic: CriticConfig = CriticConfig()
    ppo: PpoConfig = PpoConfig()
