import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from stable_baselines3 import PPO

import capsule_gym
from agents.leaderboard.candidates import all_candidates
from baselines import adaptive, goal_pulses, pd
from capsule_gym.evaluation.candidates import Candidate, find_candidate, wrap_policy
from capsule_gym.evaluation.episodes import evaluate, validation_set
from capsule_gym.evaluation.sets import parse_set
from capsule_gym.policies.policy import POLICY
from capsule_gym.sb3 import CapsuleSB3VecEnv
from tests.agents.fakes import PLANTS, Sine, make_policy, write_run
from tests.capsule_gym.policies.test_policy import make_linear_policy, make_policy_on

TINY = parse_set(PLANTS)


def test_policies_are_found_by_name(world):
    assert [candidate.name for candidate in all_candidates()] == ["adaptive", "bold", "learnt"]
    description = "PPO, the whole torque, trained with randomization wide"
    assert find_candidate("learnt").description == description
    assert find_candidate("learnt/seed-2").name == "learnt/seed-2"
    assert find_candidate("bold").trained == []


def test_a_description_says_which_torque_is_limited():
    policy = capsule_gym.load_policy("residual-ppo")
    action = "a residual torque of up to 3 N m on `baselines:adaptive`"
    assert f"{action}, as total torque, trained" in policy.description
    residual = replace(policy, env_kwargs=policy.env_kwargs | {"total_torque": False})
    assert f"{action}, trained" in residual.description


@pytest.mark.parametrize(
    ("place", "seeds"),
    [("", [2, 10]), ("/seed-2", [2]), ("/seed-2/policy.safetensors", [2])],
)
def test_runs_are_found_by_path(world, place, seeds):
    for name_or_path in (f"learnt{place}", f"{world}/checkpoints/learnt{place}"):
        found = find_candidate(name_or_path)
        assert [policy.training_seed for policy in found.trained] == seeds


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("lernt", r"policy \(adaptive, bold\), a checkpoint \(learnt\), .* got 'lernt'"),
        ("empty", r"run's folder, which holds best/.*empty'"),
        ("model.zip", r"model\.zip is not a policy file"),
    ],
)
def test_unknown_policies_raise_an_error_that_lists_the_known_ones(
    world, monkeypatch, name, message
):
    (world / "empty").mkdir()
    (world / "model.zip").write_bytes(b"PK")
    monkeypatch.chdir(world)
    with pytest.raises(ValueError, match=message):
        find_candidate(name)


def test_a_broken_file_of_a_checkpoint_is_named(world):
    run = world / "checkpoints" / "learnt" / "seed-2"
    (run / "policy.safetensors").write_bytes(b"half")
    with pytest.raises(ValueError, match=r"seed-2.policy\.safetensors is not a policy file"):
        all_candidates()


@pytest.mark.parametrize(
    ("seed", "changes", "message"),
    [
        (10, {}, r"different training seeds, got \[10, 10\]"),
        (2, {"algorithm": "sac"}, "runs of one kind"),
    ],
)
def test_the_runs_of_a_checkpoint_must_differ_in_the_seed_alone(world, seed, changes, message):
    write_run(world / "checkpoints" / "learnt" / "seed-2", seed, **changes)
    with pytest.raises(ValueError, match=message):
        all_candidates()


def test_all_candidates_must_act_under_one_limit(world):
    for seed in (2, 10):
        run = world / "checkpoints" / "learnt" / f"seed-{seed}"
        write_run(run, seed, env_kwargs={"torque_limit": 1.0})
    message = r"must act under a torque_limit of 1\.5 N m as all others, got 1\.0"
    with pytest.raises(ValueError, match=message):
        all_candidates()


@pytest.fixture
def my_rules(tmp_path, monkeypatch):
    """A module in the current folder, which must not change the paths of modules."""
    monkeypatch.chdir(tmp_path)
    path = list(sys.path)
    module = tmp_path / "my_rules.py"
    module.write_text("def zero(observations): return 0.0 * observations[:, 1:2]\nnumber = 3\n")
    yield module
    sys.modules.pop("my_rules", None)
    assert sys.path == path


def test_a_module_is_imported_only_if_trusted(my_rules):
    with pytest.raises(ValueError, match="runs its code; --trust allows it"):
        find_candidate("my_rules:zero")
    assert "my_rules" not in sys.modules
    (policy,) = find_candidate("my_rules:zero", trust=True).policies
    assert policy.name == "my_rules:zero"
    assert evaluate(policy, TINY, horizon=0.1) == evaluate(Sine(0.0), TINY, horizon=0.1)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no_such_module:zero", "cannot be imported: No module named 'no_such_module'"),
        ("my_rules:jump", "has no attribute 'jump'"),
        ("my_rules:number", "policy must be an object with predict.* got a int"),
        ("runs/a:b", "policy must be a scripted policy"),
    ],
)
def test_what_is_no_policy_of_a_module_is_named(my_rules, name, message):
    with pytest.raises(ValueError, match=message):
        find_candidate(name, trust=True)


def test_a_module_that_lacks_a_package_is_named(my_rules):
    my_rules.write_text("import no_such_package")
    message = "cannot be imported: No module named 'no_such_package'"
    with pytest.raises(ValueError, match=message):
        find_candidate("my_rules:zero", trust=True)


@pytest.mark.parametrize("policy", [make_policy(), Sine(0.3)])
def test_policies_of_this_project_stay_as_they_are(policy):
    assert wrap_policy(policy) is policy
    message = "env_kwargs must not be given with a policy that has its own"
    with pytest.raises(TypeError, match=message):
        wrap_policy(policy, env_kwargs={})


@pytest.mark.parametrize(
    ("law", "name"), [(adaptive(), "adaptive"), (goal_pulses(), "goal-pulses")]
)
def test_a_control_law_acts_alone(law, name):
    plants = replace(TINY, task=law.task or "speed")
    assert capsule_gym.evaluate(law, plants, horizon=0.5) == evaluate(name, plants, horizon=0.5)


def test_a_control_law_is_a_policy_for_its_task():
    message = "policy must be for the task 'speed' of the set 'tiny', got 'goal_pulses', which is"
    with pytest.raises(ValueError, match=message):
        evaluate(goal_pulses(), TINY)


def test_a_run_on_a_law_of_another_package_must_be_trusted(tmp_path):
    make_policy_on("tests.agents.fakes:quiet").save(tmp_path / POLICY)
    with pytest.raises(ValueError, match="does not come with this package"):
        find_candidate(str(tmp_path))
    assert len(find_candidate(str(tmp_path), trust_controller=True).trained) == 1


def test_a_control_law_has_its_name_or_a_given_one():
    assert wrap_policy(adaptive()).name == adaptive().name
    assert wrap_policy(adaptive(), name="mine").name == "mine"


def test_an_object_with_start_alone_is_a_policy():
    started = SimpleNamespace(start=Sine(0.3).start)
    assert evaluate(started, TINY, horizon=0.5) == evaluate(Sine(0.3), TINY, horizon=0.5)
    kwargs = {"controller": "baselines:adaptive"}
    assert wrap_policy(started, env_kwargs=kwargs).env_kwargs == kwargs


def test_a_model_of_stable_baselines3():
    batch = CapsuleSB3VecEnv(2, seed=0)
    model = PPO("MlpPolicy", batch, n_steps=8, batch_size=16, seed=0, device="cpu")

    def act(observations):
        return model.predict(observations, deterministic=True)[0]

    episodes = evaluate(model, TINY, horizon=0.5)
    assert wrap_policy(model).name == "PPO"
    assert episodes == evaluate(act, TINY, horizon=0.5)
    assert episodes == evaluate(model.policy, TINY, horizon=0.5)
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
    first = evaluate(policy, TINY, horizon=0.05)
    assert evaluate(policy, TINY, horizon=0.05) == first
    starts = [[True] * 3] + [[False] * 3] * 4
    assert policy.starts == starts * 2
    assert first[0]["peak_torque"] == pytest.approx(1.5 * 0.05)


def test_arguments_of_the_environment_come_from_the_caller_or_the_policy():
    assert wrap_policy(Counting()).env_kwargs == {"control_dt": 0.01}
    mine = wrap_policy(Counting(), env_kwargs={}, name="mine")
    assert (mine.env_kwargs, mine.name) == ({}, "mine")


def test_a_function_acts_on_what_the_arguments_of_its_environment_show():
    shapes = []

    def zero(observations):
        shapes.append(observations.shape)
        return np.zeros((len(observations), 1))

    env_kwargs = {"observe_parameters": True, "control_dt": 0.1}
    evaluate(zero, TINY, env_kwargs=env_kwargs, horizon=0.2)
    assert shapes == [(3, 7)] * 2
    assert wrap_policy(zero).name == "zero"


def test_a_validation_set_has_the_plants_of_its_capsule():
    drawn = validation_set("none", "x", 0, 1, capsule_gym.Capsule(M=0.8))
    assert drawn.plants[0].M == 0.8


@pytest.mark.parametrize(
    ("name", "senses", "told"),
    [
        ("direct-ppo", "state, stick", "nothing"),
        ("residual-ppo", "state, stick, law", "nominal plant"),
        ("goal", "state, stick, estimates of M, mu", "nominal pendulum"),
        ("adaptive", "state, x", "nominal plant"),
        ("open-loop", "nothing", "nothing"),
        ("open-loop-real", "nothing", "nothing"),
        ("pd", "theta, theta_dot", "nothing"),
    ],
)
def test_the_inputs_of_policies(name, senses, told):
    assert find_candidate(name).inputs == (senses, told)


@pytest.mark.parametrize(
    ("env_kwargs", "entries", "inputs"),
    [
        ({"stack_size": 2}, 10, ("state, stick of 2 steps", "nothing")),
        ({"observe_parameters": True}, 7, ("state, stick", "M, mu")),
    ],
)
def test_the_inputs_of_a_policy_follow_from_its_environment(env_kwargs, entries, inputs):
    policy = make_linear_policy(entries, **env_kwargs)
    assert Candidate("x", (policy,), "").inputs == inputs


def every_option(period=1.0, *, gain=2.0):
    return period * gain


@pytest.mark.parametrize("law", [pd, every_option])
def test_a_law_that_was_not_called_is_named(law):
    with pytest.raises(TypeError, match=rf"{law.__name__}\(\) may be what you mean"):
        wrap_policy(law)


def test_functions_of_observations_are_policies():
    def scaled(observations, factor=0.5):
        return factor * observations[:, :1]

    def any_number(*arguments):
        return arguments[0][:, :1]

    for function in (scaled, any_number):
        act = wrap_policy(function).start([0])
        assert act(np.ones((1, 5), np.float32)).shape == (1, 1)
