"""Configurations small enough to train within a test."""

import dataclasses

import numpy as np
import torch

from agents.training.presets import PRESETS, Config

SMALL = {"num_envs": 8, "batch_size": 64, "hidden": 8, "evaluation_episodes": 2, "evaluate_every": 10_000}


def small(task: str, algo: str, **changes) -> Config:
    extra = (
        {"n_steps": 32, "n_epochs": 2}
        if algo in ("ppo", "recurrent-ppo")
        else {"learning_starts": 300, "buffer_size": 2000}
    )
    return dataclasses.replace(PRESETS[task, algo], **{**SMALL, **extra, **changes})


def weights(model) -> np.ndarray:
    return torch.cat([p.detach().flatten() for p in model.policy.parameters()]).numpy()
