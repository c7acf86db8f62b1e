import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from stable_baselines3 import PPO

import capsule_gym
from agents.leaderboard.candidates import all_candidates
from baselines import adaptive, goal_pulses
from capsule_gym.evaluation.candidates import find_candidate, wrap_policy
from capsule_gym.evaluation.episodes import evaluate, validation_set
from capsule_gym.evaluation.sets import parse_set
from capsule_gym.sb3 import CapsuleSB3VecEnv
from tests.agents.fakes import PLANTS, Sine, make_policy, write_run

TINY = parse_set(PLANTS)
MODULE = """
def zero(observations):
    return 0.0 * observations[:, 1:2]

number = 3
"""


def seeds(name_or_path):
    return [policy.training_seed for policy in find_candidate(str(name_or_path)).trained]


def test_policies_are_found_by_name_and_path(world):
    assert [c.name for c in all_candidates()] == ["adaptive", "bold", "learnt"]
    assert (
        find_candidate("learnt").description
        == "PPO, the whole torque, trained with randomization wide"
    )
    folder = world / "checkpoints" / "learnt"
    for name in ("learnt", folder):
        assert seeds(name) == [2, 10]
    for name in ("learnt/seed-2", folder / "seed-2", folder / "seed-2" / "policy.safetensors"):
        assert seeds(name) == [2]
    assert (
        find_candidate("learnt/seed-2").name == "learnt/seed-2"
        and find_candidate("bold").trained == []
    )


def test_unknown_policies_raise_an_error_that_lists_the_known_ones(world):
    (world / "empty").mkdir()
    (world / "model.zip").write_bytes(b"PK")
    for name, message in (
        ("lernt", r"policy \(adaptive, bold\), a checkpoint \(learnt\), .* got 'lernt'"),
        (world / "empty", r"run's folder, which holds best/.*empty'"),
        (world / "model.zip", r"model\.zip is not a policy file"),
    ):
        with pytest.raises(ValueError, match=message):
            find_candidate(str(name))


def test_malformed_checkpoints_raise_an_error(world):
    run = world / "checkpoints" / "learnt" / "seed-2"
    (run / "policy.safetensors").write_bytes(b"half")
    with pytest.raises(ValueError, match=r"seed-2.policy\.safetensors is not a policy file"):
        all_candidates()
    write_run(run, 10)
    with pytest.raises(ValueError, match=r"different training seeds, got \[10, 10\]"):
        all_candidates()
    write_run(run, 2, algorithm="sac")
    with pytest.raises(ValueError, match="runs of one kind"):
        all_candidates()
    for seed in (2, 10):
        write_run(run.with_name(f"seed-{seed}"), seed, env_kwargs={"torque_limit": 1.0})
    with pytest.raises(
        ValueError, match=r"must act under a torque_limit of 1\.5 N m as all others, got 1\.0"
    ):
        all_candidates()


def test_a_module_is_imported_only_if_trusted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_rules.py").write_text(MODULE)
    path = list(sys.path)
    try:
        with pytest.raises(ValueError, match="runs its code; --trust allows it"):
            find_candidate("my_rules:zero")
        assert "my_rules" not in sys.modules
        (policy,) = find_candidate("my_rules:zero", trust=True).policies
        assert evaluate(policy, TINY, horizon=0.1) == evaluate(Sine(0.0), TINY, horizon=0.1)
        for name, message in (
            ("no_such_module:zero", "cannot be imported: No module named 'no_such_module'"),
            ("my_rules:jump", "has no attribute 'jump'"),
            ("my_rules:number", "policy must be an object with predict.* got a int"),
            ("runs/a:b", "policy must be a scripted policy"),
        ):
            with pytest.raises(ValueError, match=message):
                find_candidate(name, trust=True)
        (tmp_path / "my_rules.py").write_text("import no_such_package")
        sys.modules.pop("my_rules")
        with pytest.raises(
            ValueError, match="cannot be imported: No module named 'no_such_package'"
        ):
            find_candidate("my_rules:zero", trust=True)
    finally:
        sys.modules.pop("my_rules", None)
    assert sys.path == path


def test_policies_of_this_project_stay_as_they_are():
    for policy in (make_policy(), Sine(0.3)):
        assert wrap_policy(policy) is policy
        with pytest.raises(
            TypeError, match="env_kwargs must not be given with a policy that has its own"
        ):
            wrap_policy(policy, env_kwargs={})


@pytest.mark.parametrize(("law", "name"), [(adaptive, "adaptive"), (goal_pulses, "goal-pulses")])
def test_a_control_law_acts_alone(law, name):
    plants = replace(TINY, task=law().task or "speed")
    assert capsule_gym.evaluate(law(), plants, horizon=0.5) == evaluate(name, plants, horizon=0.5)
    assert wrap_policy(law()).name == law().name and wrap_policy(law(), name="mine").name == "mine"


def test_an_object_with_start_alone_is_a_policy():
    started = SimpleNamespace(start=Sine(0.3).start)
    assert evaluate(started, TINY, horizon=0.5) == evaluate(Sine(0.3), TINY, horizon=0.5)
    kwargs = {"controller": "baselines:adaptive"}
    assert wrap_policy(started, env_kwargs=kwargs).env_kwargs == kwargs


def test_a_model_of_stable_baselines3():
    model = PPO(
        "MlpPolicy", CapsuleSB3VecEnv(2, seed=0), n_steps=8, batch_size=16, seed=0, device="cpu"
    )
    assert wrap_policy(model).name == "PPO"
    episodes = evaluate(model, TINY, horizon=0.5)
    by_hand = evaluate(
        lambda observations: model.predict(observations, deterministic=True)[0], TINY, horizon=0.5
    )
    assert episodes == by_hand == evaluate(model.policy, TINY, horizon=0.5)
    assert episodes[0]["peak_torque"] > 0.0


class Counting:
    """A recurrent policy whose action is the number of its calls."""

    env_kwargs = {"control_dt": 0.01}  # noqa: RUF012 (read only)

    def __init__(self):
        self.starts = []

    def predict(self, observations, state=None, episode_start=None, deterministic=False):
        assert deterministic
        self.starts.append(episode_start.tolist())
        state = (0 if state is None else state) + 1
        return np.full((len(observations), 1), 0.01 * state), state


def test_a_recurrent_policy_starts_every_batch_without_a_state():
    policy = Counting()
    first, second = (evaluate(policy, TINY, horizon=0.05) for _ in range(2))
    assert first == second and policy.starts == [[True] * 3, *[[False] * 3] * 4] * 2
    assert first[0]["peak_torque"] == pytest.approx(1.5 * 0.05)


def test_arguments_of_the_environment_come_from_the_caller_or_the_policy():
    assert wrap_policy(Counting()).env_kwargs == {"control_dt": 0.01}
    mine = wrap_policy(Counting(), env_kwargs={}, name="mine")
    assert (mine.env_kwargs, mine.name) == ({}, "mine")
    shapes = []

    def zero(observations):
        shapes.append(observations.shape)
        return np.zeros((len(observations), 1))

    assert wrap_policy(zero).name == "zero"
    evaluate(zero, TINY, env_kwargs={"observe_parameters": True, "control_dt": 0.1}, horizon=0.2)
    assert (
        shapes == [(3, 7)] * 2
        and validation_set("none", "x", 0, 1, capsule_gym.Capsule(M=0.8)).plants[0].M == 0.8
    )
