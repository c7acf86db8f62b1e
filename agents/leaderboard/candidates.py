"""The policies of the leaderboard: a row for each."""

from baselines.policies import SCRIPTED, TASK_SCRIPTED
from capsule_gym.evaluation.candidates import Candidate, checkpoint_names, find_candidate
from capsule_gym.tasks.task import TORQUE_LIMIT


def all_candidates(task: str = "speed") -> list[Candidate]:
    """All rows of a task's leaderboard: scripted policies, then checkpoints.

    Raises:
        ValueError: if a checkpoint is incomplete, or has another torque limit than the scripted
            policies.
    """
    scripted = SCRIPTED if task == "speed" else TASK_SCRIPTED
    found = [find_candidate(name) for name in (*scripted, *checkpoint_names())]
    for candidate in found:
        for policy in candidate.trained:
            limit = policy.env_kwargs.get("torque_limit", TORQUE_LIMIT)
            if limit != TORQUE_LIMIT:
                accepted = f"a torque_limit of {TORQUE_LIMIT} N m as all others"
                raise ValueError(f"{candidate.folder} must act under {accepted}, got {limit}")
    return [candidate for candidate in found if candidate.task == task]
