"""Invalid arguments of identification, policies and evaluation: the error names them."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from agents.training.config import Config
from capsule_gym import Capsule, CapsuleEnv, identify, sensitivity
from capsule_gym.checks import first_cause
from capsule_gym.envs.simulation import Simulation
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.evaluation.episodes import evaluate, summarise
from capsule_gym.evaluation.sets import load_set, parse_set
from capsule_gym.evaluation.statistics import estimate, paired_difference
from capsule_gym.identification.excitation import Excitation
from capsule_gym.identification.log import read_log
from capsule_gym.identification.ranges import OTHERS
from capsule_gym.identification.recording import record
from capsule_gym.identification.shooting import PLANT
from capsule_gym.parameters import NOMINAL
from capsule_gym.policies.loading import load_policy
from capsule_gym.policies.rollout import rollout
from capsule_gym.rendering import write_gif
from capsule_gym.tasks.registry import find_task
from tests.agents.fakes import Sine
from tests.capsule_gym.evaluation.test_sets import plant
from tests.capsule_gym.identification.test_derivatives import START
from tests.capsule_gym.policies.test_policy import make_policy

T = np.arange(0.0, 3.0, 0.01)
LOG = {"t": T, "torque": 0.1 * np.sin(T), "theta": 0.1 * np.sin(T)}
KNOWN = {name: getattr(NOMINAL, name) for name in PLANT} | dict.fromkeys(OTHERS, 0.0)
REAL = CapsuleEnv(disturbances="real")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"known": {"latancy": 0.01}}, "did you mean 'latency'"),
        ({"known": {"latency": -1.0}}, r"known\['latency'\] must be"),
        ({"known": {"c": 92.3}}, "physics_dt must be at most .* for this capsule"),
        ({"known": KNOWN, "prior": "none"}, "must leave a quantity to estimate"),
        ({"ranges": {"latancy": (0.0, 0.01)}}, "ranges must have .*did you mean 'latency'"),
        ({"ranges": {"lag": (0.2, 0.1)}}, r"ranges\['lag'\] must be a pair"),
        ({"ranges": {"latency": (-0.1, 0.1)}}, r"ranges\['latency'\]\[0\] must be"),
        ({"ranges": {"latency": (0.0, 1e3)}}, r"ranges\['latency'\]\[1\] must be"),
        (
            {"ranges": {"k": (0.0, 0.1)}, "known": {"k": 0.3}},
            r"ranges\['k'\] must be of .* not known",
        ),
        ({"ranges": {"M": (-1.0, 0.1)}}, "Randomization.M"),
        ({"physics_dt": 0.011}, "physics_dt must be a number of s from 1e-5 to 0.01, got 0.011"),
        ({"prior": "reel"}, "^prior must be a Randomization or one of .*, got 'reel'"),
    ],
)
def test_an_invalid_argument_of_the_identification_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        identify(LOG, **arguments)


@pytest.mark.parametrize(
    ("log", "message"),
    [
        (LOG | {"t": 3.0}, "column 'torque' must be one number for each row"),
        (LOG | {"theta": ["far"] * len(T)}, "column 'theta' must contain numbers"),
        ({"t": T, "torque": T, "x": T}, "log must be of .*'theta' or 'theta_dot'"),
    ],
)
def test_an_invalid_log_is_named(log, message):
    with pytest.raises(ValueError, match=message):
        read_log(log)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"epsilon": -1.0}, "^epsilon must be a finite number >= 0, got -1"),
        ({"training_seed": 2**63}, r"^training_seed must be an integer from 0 to 2\*\*63 - 1,"),
        ({"variance": np.array([1.0, 1.0, -1.0, 1.0, 1.0])}, "variance must be >= 0"),
        ({"variance": np.zeros(5), "epsilon": 0.0}, "and with epsilon > 0"),
        ({"env_kwargs": {"goal_env": True}}, "env_kwargs must be a dict with keys out of"),
    ],
)
def test_an_invalid_field_of_a_policy_is_named(fields, message):
    with pytest.raises(ValueError, match=message):
        make_policy(**fields)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"revision": ""}, "revision must be a string that is not empty, got ''"),
        ({"env_kwargs": []}, r"env_kwargs must be a dict with .*, got \[\]"),
        ({"env_kwargs": {"controller": len}}, r"env_kwargs\['controller'\] must be None or an"),
        ({"env_kwargs": {"task": find_task("goal")}}, r"env_kwargs\['task'\] must be the name"),
    ],
)
def test_a_field_of_a_policy_of_a_wrong_type_is_named(fields, message):
    with pytest.raises(TypeError, match=message):
        make_policy(**fields)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("residual-pppo", r"direct-ppo, .*residual-ppo, .*did you mean 'residual-ppo'\?"),
        ("direct_ppo", r"direct-ppo, .*residual-ppo, .*did you mean 'direct-ppo'\?$"),
        ("direct-sac/seed-9", r"did you mean 'direct-sac/seed-\d'\?"),
        ("goal-pulses", r"law: gym\.make\(\.\., controller='baselines:goal_pulses'\)"),
        ("direct-sac/../direct-ppo", r"got 'direct-sac/\.\./direct-ppo'"),
        ("a" * 10_000, r"got 'a{499} \.\. a{499}'"),
    ],
)
def test_an_unknown_policy_is_named(name, message):
    with pytest.raises(ValueError, match=message):
        load_policy(name)


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("papre", "'papre'"),
        ("x" * 10_000, "'xxxx"),
        ("/dev/null", "'/dev"),
        ("a\0b", "'a.*b"),
        (None, "'None"),
    ],
)
def test_an_unknown_set_is_named(name, shown):
    message = f"^set must be one of .*, or the path of a JSON file, got {shown}"
    with pytest.raises(ValueError, match=message):
        load_set(name)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"task": "fast"}, "set.task must be one of"),
        ({"name": " "}, "set.name must be a string that is not empty"),
        ({"plants": []}, "set.plants must be a list of at least one plant"),
        (plant(capsule={"m": -1.0}), r"plants\[0\].capsule: Capsule.m must be"),
    ],
)
def test_an_invalid_entry_of_a_set_is_named(changes, message):
    with pytest.raises(ValueError, match=message):
        parse_set(plant() | changes)


def goal_model():
    """A model that observes dicts."""
    space = CapsuleEnv(task="goal", goal_env=True).observation_space
    return SimpleNamespace(predict=len, observation_space=space)


@pytest.mark.parametrize(
    ("policy", "arguments", "message"),
    [
        (lambda seen: np.zeros(3), {}, r"of shape \(100, 1\), got array"),
        (lambda seen: np.full((100, 1), np.nan), {}, "must be finite"),
        (lambda seen: "full", {}, "got 'full'"),
        (goal_model(), {}, "policy must observe .* arrays, got a model of Dict"),
        (len, {"env_kwargs": {"capsule": {}}}, "'capsule', which the set 'nominal'"),
        (len, {"env_kwargs": {"control_dt": 0}}, "^control_dt must be a finite number .*, got 0"),
        (Sine(0.3), {"horizon": 1e9}, r"horizon must be a number from 0\.02 to 1e\+06 .*, got 1"),
        ("goal/seed-0", {}, "for the task 'speed' .*, got 'goal/seed-0', which is"),
    ],
)
def test_an_invalid_argument_of_an_evaluation_is_named(policy, arguments, message):
    with pytest.raises(ValueError, match=message):
        evaluate(policy, "nominal", **arguments)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sensitivity((2.0, 0.0, 0.0, 0.0), [0.1]), "state must be .*, got"),
        (lambda: sensitivity(START, [0.1], ("nu",)), "wrt must contain names out of .* got 'nu'"),
        (
            lambda: sensitivity(START, [0.1], ("stribeck_speed",)),
            "wrt may contain 'stribeck_speed' only where",
        ),
        (lambda: sensitivity(START, [9.0] * 20), r"torques must keep .* in torques\[\d+\]"),
        (
            lambda: sensitivity((1.5, 5.0, 0.0, 0.0), [0.0] * 3),
            r"torques\[0\], between 0 and 0\.02 s$",
        ),
        (lambda: sensitivity(START, [[0.1]]), "torques must be a sequence of numbers"),
        (lambda: sensitivity(START, [0.1, 1e9]), "torques must be a sequence of numbers"),
        (lambda: sensitivity(START, [0.1], capsule=Capsule(c=20.0)), "physics_dt must be at most"),
        (
            lambda: sensitivity(START, [0.1], physics_dt=0.003),
            r"physics_dt must be control_dt=0\.02 s over a whole number",
        ),
        (
            lambda: record(REAL, path="nowhere/log.csv"),
            "path must be that of a new file in a folder that",
        ),
        (
            lambda: Excitation(torque_limit=0.0),
            r"Excitation\.torque_limit must be a finite number > 0, got 0",
        ),
        (
            lambda: rollout(Simulation(2), load_policy("residual-ppo"), 9),
            "policy .* 5 entries, .*takes 10",
        ),
        (
            lambda: rollout(Simulation(2), load_policy("direct-ppo"), 0),
            "steps must be an integer >= 1, got 0",
        ),
        (lambda: summarise([]), r"episodes must be as many for every training seed, .* got \[\]"),
        (lambda: estimate([1.0, 2.0, 3.0]), r"scores must have the shape .* got \(3,"),
        (lambda: estimate(np.empty((1, 0))), r"scores must have the shape .* got \(1, 0\)"),
        (
            lambda: paired_difference([[1.0, 2.0, 3.0]], [[1.0, 2.0]]),
            "same episodes, got .* and ",
        ),
        (
            lambda: Config(hidden=2000).check(),
            "^hidden must be an integer >= 1 and <= 1024, got 2000",
        ),
        (
            lambda: Config(mass_range=(0.5, 0.4)).env_kwargs(),
            "^mass_range and friction_range: Randomization.M",
        ),
        (lambda: write_gif([], Path("none.gif")), "frames must contain at least one picture"),
    ],
)
def test_an_invalid_value_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sensitivity(START, ["far"]), "torques must be .*, got .*far"),
        (lambda: sensitivity(START, [0.1], "mu"), "wrt must be a sequence of names"),
        (lambda: sensitivity(START, [0.1], iter(["mu"])), "wrt must be a sequence of names"),
        (
            lambda: sensitivity(START, [0.1], capsule="paper"),
            "capsule must be a Capsule, got 'paper'",
        ),
        (lambda: identify(3.0), "log must be the path of a CSV file or a mapping"),
        (lambda: identify(LOG, known=3), "known must be a dict of numbers by name, got 3"),
        (
            lambda: record(REAL, "direct-ppo"),
            "policy must be None, a function, .* got 'direct-ppo'",
        ),
        (lambda: load_policy(3), "name_or_path must be a policy's name or a path, got 3"),
        (lambda: evaluate(3), "policy must be an object with predict.* got a int"),
        (lambda: evaluate(len, env_kwargs=3), "^env_kwargs must be None or a dict, got 3"),
        (lambda: evaluate(Sine), "policy must be an object with predict.* got the class"),
        (
            lambda: evaluate(find_candidate("pd"), env_kwargs={}),
            "must not be given with .* or a candidate",
        ),
    ],
)
def test_a_value_of_a_wrong_type_is_named(call, message):
    with pytest.raises(TypeError, match=message):
        call()


def test_the_first_cause_of_an_error_is_one_line():
    assert first_cause(ValueError("one\ntwo")) == "one"
    assert first_cause(ValueError("because of:\n\n two\nthree")) == "because of: two"
    assert first_cause(ValueError()) == ""
