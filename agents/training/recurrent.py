"""PPO with a memory, of sb3-contrib: what makes its updates cheaper, and how its policy is evaluated.

Such an agent has no policy file: `capsule_gym.Policy` is a function of the present observation.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sb3_contrib import RecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from agents.evaluation.policies import Policy, wrap_policy
from agents.training.presets import BEST, MODEL, RecurrentPPOConfig, read_config
from capsule_gym import load_policy

States = tuple[torch.Tensor, torch.Tensor]


class RecurrentActorCritic(RecurrentActorCriticPolicy):
    """sb3-contrib's policy, whose LSTM runs over a sequence in one call also where an episode begins with it."""

    @staticmethod
    def _process_sequence(  # type: ignore[override] # whose annotation says one tensor where it returns a pair
        features: torch.Tensor, lstm_states: States, episode_starts: torch.Tensor, lstm: nn.LSTM
    ) -> tuple[torch.Tensor, States]:
        """The LSTM's outputs and last state; sb3-contrib's own calls it at every step where any episode begins.

        Its buffer begins a sequence with every episode, so that only the first state is ever to be cleared.
        """
        count = lstm_states[0].shape[1]
        starts = episode_starts.reshape(count, -1)
        assert not starts[:, 1:].any(), "an episode must begin with a sequence, not within it"
        kept = (1.0 - starts[:, 0]).reshape(1, count, 1)
        sequences = features.reshape(count, -1, lstm.input_size).swapaxes(0, 1)
        outputs, states = lstm(sequences, (kept * lstm_states[0], kept * lstm_states[1]))
        return outputs.swapaxes(0, 1).flatten(end_dim=1), states


class _InTraining:
    """Predicts with an agent as it learns, by the present statistics of its observations."""

    def __init__(self, model: RecurrentPPO) -> None:
        env = model.get_vec_normalize_env()
        assert isinstance(env, VecNormalize)
        self.model, self.env = model, env

    def predict(self, observations: np.ndarray, **kwargs: Any) -> Any:
        """As SB3's."""
        return self.model.predict(self.env.normalize_obs(observations), **kwargs)


def present_policy(name: str, model: RecurrentPPO, env_kwargs: Mapping[str, Any]) -> Policy:
    """What an agent acts by at present: deterministic, its memory begun anew with every episode.

    Args:
        name: as it appears in results.
        model: the agent, with the environments that it learns in.
        env_kwargs: the arguments of the environment that it acts in.
    """
    return wrap_policy(_InTraining(model), name=name, env_kwargs=env_kwargs)


def load_best(run: Path) -> Policy:
    """The best policy of a run of one's own: one with a memory is unpickled, and a control law's code runs.

    Args:
        run: its folder.

    Raises:
        OSError: if it has no best agent.
        RunError: if it is no folder of a run.
        ValueError: if it has no best policy.
    """
    config = read_config(run)
    if not isinstance(config, RecurrentPPOConfig):
        return load_policy(run, trust_controller=True)
    model = RecurrentPPO.load(run / BEST / MODEL, device="cpu")
    return wrap_policy(model, name=run.name, env_kwargs=config.env_kwargs())
