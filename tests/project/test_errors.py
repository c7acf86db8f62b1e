"""What is refused: invalid arguments of functions and commands, and missing libraries; the error
names them."""

import importlib
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from agents.distillation.__main__ import main as distil
from agents.study import main as study
from agents.training.algorithms import make_env
from agents.training.config import Config, RunError
from baselines.drawing import style
from benchmarks import fresh_draws, identification, rig, throughput, training
from benchmarks import sensitivity as derivatives
from capsule_gym import (
    Capsule,
    CapsuleEnv,
    CapsuleVectorEnv,
    Randomization,
    dynamics,
    identify,
    sensitivity,
)
from capsule_gym.checks import first_cause
from capsule_gym.control.controller import Controller, CoreLaw
from capsule_gym.control.laws.adaptive import adaptive
from capsule_gym.control.laws.feedback_linearisation import feedback_linearising
from capsule_gym.control.laws.gains import known_parameters
from capsule_gym.control.laws.gait import gait
from capsule_gym.control.laws.profiles import TABLE_1, seven_phases, six_phases
from capsule_gym.core import native
from capsule_gym.demo import main as demo
from capsule_gym.envs.simulation import Simulation
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.evaluation.episodes import evaluate, summarise
from capsule_gym.evaluation.sets import load_set, parse_set
from capsule_gym.evaluation.statistics import estimate, paired_difference
from capsule_gym.export import main as export
from capsule_gym.export.exported import Exported
from capsule_gym.identification.__main__ import main as identify_file
from capsule_gym.identification.excitation import Excitation
from capsule_gym.identification.fit import OTHERS
from capsule_gym.identification.log import read_log
from capsule_gym.identification.recording import record
from capsule_gym.identification.shooting import PLANT
from capsule_gym.parameters import NOMINAL, Disturbances
from capsule_gym.policies.policy import load_policy
from capsule_gym.policies.rollout import rollout
from capsule_gym.rendering import write_gif
from capsule_gym.sb3 import CapsuleSB3VecEnv
from capsule_gym.tasks.registry import find_task
from capsule_gym.tasks.task import Task
from tests.agents.fakes import Sine
from tests.capsule_gym.evaluation.test_sets import plant
from tests.capsule_gym.identification.test_derivatives import START
from tests.capsule_gym.policies.test_policy import make_policy
from train import main as train

T = np.arange(0.0, 3.0, 0.01)
OSCILLATOR = dict.fromkeys(("omega", "alpha", "bias", "K_theta", "K_theta_dot", "dt"), 1.0)
OSCILLATOR |= dict.fromkeys(("E_a", "E_b", "real", "imaginary"), (1.0, 2.0, 3.0))
LOG = {"t": T, "torque": 0.1 * np.sin(T), "theta": 0.1 * np.sin(T)}
KNOWN = {name: getattr(NOMINAL, name) for name in PLANT} | dict.fromkeys(OTHERS, 0.0)
GAIT = known_parameters("gait")
MODEL = SimpleNamespace(
    predict=len, observation_space=CapsuleEnv(task="goal", goal_env=True).observation_space
)
GOALS, REAL = CapsuleEnv(task="goal", goal_env=True), CapsuleEnv(disturbances="real")
SLOW = Controller("slow", lambda *numbers: (0.0, numbers[4]), np.zeros((1, 2)), dt=2000.0)
ORIGIN = (0.0, 0.0, 0.0, 0.0)
NO_SETS = [
    (n, f"^set must be one of .* got '{n!s:.4}") for n in ("x" * 10_000, "/dev/null", "a\0b", None)
]
CALLS = [
    (
        lambda: CapsuleEnv(randomization=Randomization(M=(0.001, 0.5), mu=(5.0, 20.0))),
        ValueError,
        "Painleve",
    ),
    *(
        (lambda k=k: k(0.5), TypeError, "positional")
        for k in (Capsule, Config, Disturbances, Randomization)
    ),
    (
        lambda: CapsuleEnv(render_mode=np.array(["human", "human"])),
        ValueError,
        "render_mode must be",
    ),
    (
        lambda: CapsuleEnv(tusk="goal"),
        TypeError,
        "unexpected keyword argument 'tusk'; did you mean 'task'",
    ),
    (
        lambda: CapsuleEnv(mu=0.1),
        TypeError,
        r"'mu'; every reset draws it from randomization=Randomization\(mu=",
    ),
    (
        lambda: CapsuleEnv(capsule={"wheels": 4}),
        ValueError,
        r"^capsule must have fields out of .*, got 'wheels'",
    ),
    (
        lambda: CapsuleEnv(randomization={"M": 0.5}),
        TypeError,
        r"^randomization: Randomization.M must be a pair",
    ),
    (
        lambda: CapsuleEnv(task="fast"),
        ValueError,
        r"^task must be a Task or one of \[.*'speed'.*\], got ",
    ),
    (
        lambda: CapsuleEnv(task=1),
        TypeError,
        r"^task must be a Task or one of \[.*'speed'.*\], got ",
    ),
    (
        lambda: CapsuleVectorEnv(2, max_episode_steps=0),
        ValueError,
        "max_episode_steps must be an integer >= 1, or -1",
    ),
    (
        lambda: CapsuleVectorEnv(2, max_episode_steps=-2),
        ValueError,
        "max_episode_steps must be .*, got -2",
    ),
    (
        lambda: CapsuleVectorEnv(3).reset(seed=2**128 - 2),
        ValueError,
        r"^seed must be .* from 0 to 2\*\*128 - 3, None",
    ),
    (lambda: CapsuleEnv(residual_limit=0.0), ValueError, "^residual_limit must be > 0"),
    (
        lambda: CapsuleEnv(stack_size=101),
        ValueError,
        "^stack_size must be an integer from 1 to 100, got 101",
    ),
    (
        lambda: CapsuleEnv(physics_dt=0.003),
        ValueError,
        "^physics_dt must be control_dt=0.02 s over .*, got 0.003",
    ),
    (
        lambda: Capsule(slope=1.51),
        ValueError,
        r"^Capsule\.slope must be a finite number from -1\.5 to 1\.5, got 1\.51",
    ),
    (
        lambda: Randomization(log_mu=1),
        TypeError,
        "^Randomization.log_mu must be True or False, got 1",
    ),
    (
        lambda: make_policy(epsilon=-1.0),
        ValueError,
        "^epsilon must be a finite number >= 0, got -1",
    ),
    (
        lambda: make_policy(training_seed=2**63),
        ValueError,
        r"^training_seed must be an integer from 0 to 2\*\*63 - 1,",
    ),
    (
        lambda: CapsuleVectorEnv(2, render_mode="human"),
        ValueError,
        "render_mode of a batch must be None or",
    ),
    (
        lambda: CapsuleSB3VecEnv(2, 0, privileged=True, task="goal", goal_env=True),
        ValueError,
        "privileged must be",
    ),
    (
        lambda: CoreLaw("oscillator", **{**OSCILLATOR, "real": 1.0}),
        ValueError,
        "real must be 3 numbers, got",
    ),
    (lambda: CoreLaw("odd"), ValueError, "name must be one of none, adaptive, .*, got 'odd'"),
    (
        lambda: CoreLaw("oscillator"),
        TypeError,
        "'oscillator' takes the constants omega, .*, dt, got $",
    ),
    (
        lambda: CoreLaw("oscillator", **OSCILLATOR, K=1.0),
        TypeError,
        "the constants omega, .*, got .*, K$",
    ),
    (lambda: CoreLaw("none")(*ORIGIN, (0.0, 0.0), (0.0, 0.0)), ValueError, "must have the shapes"),
    (lambda: native.address(np.zeros((2, 2))[:, 0]), ValueError, "array must be C-contiguous"),
    (
        lambda: CapsuleEnv(controller=SLOW),
        ValueError,
        r"^physics_dt must be the law's step=2000.0 s over ",
    ),
    (
        lambda: sensitivity(ORIGIN, [0.1], capsule="paper"),
        TypeError,
        "capsule must be a Capsule, got 'paper'",
    ),
    (lambda: sensitivity(ORIGIN, [0.1], "mu"), TypeError, "wrt must be a sequence of names"),
    (
        lambda: sensitivity(ORIGIN, [0.1], iter(["mu"])),
        TypeError,
        "wrt must be a sequence of names",
    ),
    (lambda: sensitivity(ORIGIN, ["far"]), TypeError, "torques must be .*, got .*far"),
    (lambda: sensitivity((2.0, 0.0, 0.0, 0.0), [0.1]), ValueError, "state must be .*, got"),
    (
        lambda: sensitivity(START, [0.1], ("nu",)),
        ValueError,
        "wrt must contain names out of .* got 'nu'",
    ),
    (
        lambda: sensitivity(START, [0.1], ("stribeck_speed",)),
        ValueError,
        "wrt may contain 'stribeck_speed' only where",
    ),
    (lambda: sensitivity(START, [9.0] * 20), ValueError, r"torques must keep .* in torques\[\d+\]"),
    (
        lambda: sensitivity((1.5, 5.0, 0.0, 0.0), [0.0] * 3),
        ValueError,
        r"torques\[0\], between 0 and 0\.02 s$",
    ),
    (
        lambda: sensitivity(START, [0.1], capsule=Capsule(c=20.0)),
        ValueError,
        "physics_dt must be at most",
    ),
    (lambda: identify(3.0), TypeError, "log must be the path of a CSV file or a mapping"),
    (lambda: identify(LOG, known={"latancy": 0.01}), ValueError, "did you mean 'latency'"),
    (
        lambda: identify(LOG, known={"c": 92.3}),
        ValueError,
        "physics_dt must be at most .* for this capsule",
    ),
    (lambda: identify(LOG, known=3), TypeError, "known must be a dict of numbers by name, got 3"),
    (
        lambda: identify(LOG, prior="reel"),
        ValueError,
        "^prior must be a Randomization or one of .*, got 'reel'",
    ),
    (
        lambda: Randomization(stribeck_speed=(0.0, 0.1)),
        ValueError,
        r"Randomization\.stribeck_speed\[0\] must .* 0 < l",
    ),
    (
        lambda: make_policy(env_kwargs={"goal_env": True}),
        ValueError,
        "env_kwargs must be a dict with keys out of",
    ),
    (lambda: identify(LOG, known={"latency": -1.0}), ValueError, r"known\['latency'\] must be"),
    (lambda: identify(LOG, prior="narrow"), ValueError, "must be a Randomization or one of"),
    (
        lambda: identify(LOG, known=KNOWN, prior="none"),
        ValueError,
        "must leave a quantity to estimate",
    ),
    (
        lambda: Config(hidden=2000).check(),
        ValueError,
        "^hidden must be an integer >= 1 and <= 1024, got 2000",
    ),
    (
        lambda: Config(mass_range=(0.5, 0.4)).env_kwargs(),
        ValueError,
        "^mass_range and friction_range: Randomization.M",
    ),
    (
        lambda: read_log({**LOG, "t": 3.0}),
        ValueError,
        "column 'torque' must be one number for each row",
    ),
    (
        lambda: record(REAL, path="nowhere/log.csv"),
        ValueError,
        "path must be that of a new file in a folder that",
    ),
    (
        lambda: record(REAL, "direct-ppo"),
        TypeError,
        "policy must be None, a function, .* got 'direct-ppo'",
    ),
    (
        lambda: Excitation(torque_limit=0.0),
        ValueError,
        r"Excitation\.torque_limit must be a finite number > 0, got 0",
    ),
    (
        lambda: dynamics.contact_phase(*ORIGIN, Capsule()),
        TypeError,
        "plant must be a Plant, such as",
    ),
    (
        lambda: Controller(5, len, np.zeros((1, 2))),
        TypeError,
        "Controller.name must be a string, got 5",
    ),
    (lambda: CapsuleSB3VecEnv(2, "a"), TypeError, "seed must be an integer .*, got 'a'"),
    (
        lambda: summarise([]),
        ValueError,
        "episodes must be as many for every training seed, .* got \\[\\]",
    ),
    (
        lambda: evaluate(len, "nominal", env_kwargs={"capsule": {}}),
        ValueError,
        "'capsule', which the set 'nominal'",
    ),
    (
        lambda: evaluate(MODEL, "nominal"),
        ValueError,
        "policy must observe .* arrays, got a model of Dict",
    ),
    (
        lambda: read_log({**LOG, "theta": ["far"] * len(T)}),
        ValueError,
        "column 'theta' must contain numbers",
    ),
    (
        lambda: read_log({"t": T, "torque": T, "x": T}),
        ValueError,
        "log must be of .*'theta' or 'theta_dot'",
    ),
    (
        lambda: write_gif([], Path("none.gif")),
        ValueError,
        "frames must contain at least one picture",
    ),
    (
        lambda: make_policy(revision=""),
        TypeError,
        "revision must be a string that is not empty, got ''",
    ),
    (lambda: make_policy(env_kwargs=[]), TypeError, r"env_kwargs must be a dict with .*, got \[\]"),
    (
        lambda: make_policy(env_kwargs={"controller": len}),
        TypeError,
        r"env_kwargs\['controller'\] must be None or an",
    ),
    (
        lambda: make_policy(env_kwargs={"task": find_task("goal")}),
        TypeError,
        r"env_kwargs\['task'\] must be the name",
    ),
    (lambda: make_policy(variance=-np.ones(5)), ValueError, "variance must be >= 0"),
    (lambda: make_policy(variance=np.zeros(5), epsilon=0.0), ValueError, "and with epsilon > 0"),
    (lambda: parse_set({**plant(), "task": "fast"}), ValueError, "set.task must be one of"),
    (
        lambda: parse_set({**plant(), "name": " "}),
        ValueError,
        "set.name must be a string that is not empty",
    ),
    (
        lambda: parse_set({**plant(), "plants": []}),
        ValueError,
        "set.plants must be a list of at least one plant",
    ),
    (
        lambda: parse_set(plant(capsule={"m": -1.0})),
        ValueError,
        r"plants\[0\].capsule: Capsule.m must be",
    ),
    (
        lambda: evaluate(find_candidate("pd"), env_kwargs={}),
        TypeError,
        "must not be given with .* or a candidate",
    ),
    (lambda: adaptive(K1=-1.0), ValueError, "K1 must be"),
    (lambda: adaptive(eta_0=10.1), ValueError, "eta_0 must be a number > 0 and <= 10, got 10.1"),
    (lambda: adaptive(dt=7e-4), ValueError, "multiple of dt"),
    (lambda: adaptive(regularised=1), TypeError, "regularised must be True or False, got 1"),
    (lambda: gait([1.0]), ValueError, r"parameters must be 23 numbers, phi_000, .*, got \[1.0\]"),
    (
        lambda: gait((*GAIT[:-1], np.nan)),
        ValueError,
        "parameters, guard_from, must be a finite number, got nan",
    ),
    (
        lambda: gait(("1", *GAIT[1:])),
        TypeError,
        "parameters, phi_000, must be a finite number, got '1'",
    ),
    (lambda: seven_phases((0.1, 0.2), 7.8, 2.1), ValueError, "t1 to t7"),
    (lambda: seven_phases((0.2, 0.1, *TABLE_1[2:]), 7.8, 2.1), ValueError, "must increase"),
    (lambda: six_phases((0.1, 0.33, 0.9, 1.4, 5.8, 6.6), 1.0, 1.4), ValueError, "P2 must be"),
    (lambda: feedback_linearising(K_p=np.nan), ValueError, "K_p must be"),
    (
        lambda: feedback_linearising(seven_phases((*TABLE_1[:-1], 6.60005), 7.8, 2.1)),
        ValueError,
        "multiple",
    ),
    (
        lambda: evaluate(lambda seen: np.zeros(3), "nominal"),
        ValueError,
        r"of shape \(100, 1\), got array",
    ),
    (
        lambda: evaluate(lambda seen: np.full((100, 1), np.nan), "nominal"),
        ValueError,
        "must be finite",
    ),
    (lambda: evaluate(lambda seen: "full", "nominal"), ValueError, "got 'full'"),
    (
        lambda: evaluate(Sine(0.3), horizon=1e9),
        ValueError,
        r"horizon must be a number from 0\.02 to 1e\+06 .*, got 1",
    ),
    (
        lambda: evaluate(len, env_kwargs={"control_dt": 0}),
        ValueError,
        "^control_dt must be a finite number .*, got 0",
    ),
    (
        lambda: evaluate("goal/seed-0"),
        ValueError,
        "for the task 'speed' .*, got 'goal/seed-0', which is",
    ),
    (lambda: evaluate(3), TypeError, r"policy must be an object with predict.* got a int"),
    (lambda: evaluate(Sine), TypeError, r"policy must be an object with predict.* got the class"),
    (lambda: estimate([1.0, 2.0, 3.0]), ValueError, r"scores must have the shape .* got \(3,"),
    (lambda: estimate(np.empty((1, 0))), ValueError, r"scores must have the shape .* got \(1, 0\)"),
    (
        lambda: paired_difference([[1.0, 2.0, 3.0]], [[1.0, 2.0]]),
        ValueError,
        "same episodes, got .* and ",
    ),
    (
        lambda: CapsuleEnv(control_dt=1e300),
        ValueError,
        r"^control_dt must be .* \(s\), at most 1e\+06, got 1e\+300",
    ),
    (
        lambda: CapsuleEnv(physics_dt=1e-25),
        ValueError,
        r"^physics_dt must be .*>= 1e-09 \(s\).*, got 1e-25",
    ),
    (
        lambda: CapsuleEnv(control_dt=1e6),
        ValueError,
        r"^control_dt must be at most 1000000 times physics_dt=0\.002 s,",
    ),
    (
        lambda: CapsuleEnv(physics_dt=1e-9, controller=adaptive),
        ValueError,
        "^control_dt must be at most 1000000 times",
    ),
    (
        lambda: CapsuleEnv(task=Task(name="run")),
        ValueError,
        r"task\.name must be .*'speed'.*got 'run'",
    ),
    (
        lambda: Randomization(M=(0.2, 0.1)),
        ValueError,
        r"^Randomization\.M.* a pair \(low, high\) of",
    ),
    (
        lambda: Randomization(mu=(True, 2.0)),
        TypeError,
        r"^Randomization\.mu.* a pair \(low, high\)",
    ),
    # Zero is a friction coefficient, but no mass, and has no logarithm.
    (lambda: Randomization(M=(0.0, 1.0)), ValueError, r"^Randomization\.M\[0\].*0 < low"),
    (
        lambda: Randomization(mu=(5e-324, 0.1), log_mu=True),
        ValueError,
        r"mu must be within a factor .*5e-324",
    ),
    (
        lambda: CapsuleEnv(initial_range=(np.pi / 2, 0.0)),
        ValueError,
        r"^initial_range must be None or .*, got 1\.57",
    ),
    (
        lambda: CapsuleEnv(initial_range=(-0.1, 0.0)),
        ValueError,
        r"^initial_range must be .* >= 0, got -0\.1",
    ),
    (
        lambda: CapsuleEnv(initial_range=(0.0, 1e4)),
        ValueError,
        r"^initial_range must be .* <= 1000 .*, got 10000\.0",
    ),
    (
        lambda: CapsuleEnv(initial_range=(np.nan, 0.0)),
        ValueError,
        "^initial_range must be .*, got nan",
    ),
    (
        lambda: CapsuleEnv(initial_range=(0.1, 0.1), initial_noise=0.1),
        ValueError,
        "initial_noise must be 0 .*got 0.1",
    ),
    (
        lambda: CapsuleEnv(task="velocity", goal_env=True),
        ValueError,
        "^goal_env must be False for the task 'vel",
    ),
    (
        lambda: GOALS.compute_reward([0.1, 0.0], [0.1], {}),
        ValueError,
        r"^desired_goal must be .*, got \[0\.1\]$",
    ),
    (
        lambda: Disturbances(latency=-1.0),
        ValueError,
        r"^Disturbances\.latency must be a .* 0 to 0\.5, or .*-1",
    ),
    (
        lambda: Disturbances(x_noise=-1.0),
        ValueError,
        r"^Disturbances\.x_noise must be None or a number .* 1000, got -1",
    ),
    (
        lambda: Disturbances(unmeasured=("x",)),
        ValueError,
        r"^Disturbances\.unmeasured must be .* got \('x',\)",
    ),
    (lambda: Randomization(m=(0.1, 40.0), mu=(0.5, 9.0)).corners(NOMINAL), ValueError, "Painleve"),
    (
        lambda: REAL.reset(options={"disturbances": {"latency": 0.1}}),
        ValueError,
        r"must be .* 0 to 0\.016, got 0\.1",
    ),
    (
        lambda: REAL.reset(options={"disturbances": {"speed": 0.1}}),
        ValueError,
        "must be a dict with keys out of",
    ),
    (
        lambda: rollout(Simulation(2), load_policy("residual-ppo"), 9),
        ValueError,
        "policy .* 5 entries, .*takes 10",
    ),
    (
        lambda: rollout(Simulation(2), load_policy("direct-ppo"), 0),
        ValueError,
        "steps must be an integer >= 1, got 0",
    ),
    (
        lambda: load_set("papre"),
        ValueError,
        "^set must be one of .*, or the path of a JSON file, got 'papre'",
    ),
    *((lambda n=n: load_set(n), ValueError, said.replace("\0", ".*")) for n, said in NO_SETS),
    (
        lambda: load_policy("residual-pppo"),
        ValueError,
        r"direct-ppo, .*residual-ppo, .*did you mean 'residual-ppo'\?",
    ),
    (
        lambda: load_policy("direct_ppo"),
        ValueError,
        r"direct-ppo, .*residual-ppo, .*did you mean 'direct-ppo'\?$",
    ),
    (lambda: load_policy("direct-sac/seed-9"), ValueError, r"did you mean 'direct-sac/seed-\d'\?"),
    (
        lambda: load_policy("goal-pulses"),
        ValueError,
        r"law: gym\.make\(\.\., controller='baselines:goal_pulses'\)",
    ),
    (
        lambda: load_policy("direct-sac/../direct-ppo"),
        ValueError,
        r"got 'direct-sac/\.\./direct-ppo'",
    ),
    (lambda: load_policy("a" * 10_000), ValueError, r"got 'a{499} \.\. a{499}'"),
    (lambda: load_policy(3), TypeError, "name_or_path must be a policy's name or a path, got 3"),
    (
        lambda: make_env(Config(wrapper=("builtins:int",)), 0),
        RunError,
        "--wrapper .* not a subclass of",
    ),
]


@pytest.mark.parametrize(
    ("call", "error", "message"), CALLS, ids=[message for *_, message in CALLS]
)
def test_an_invalid_argument_is_named(call, error, message):
    with pytest.raises(error, match=message):
        call()


COUNTS = [*(("--plants", each) for each in (identification, rig)), ("--total-steps", rig)]
COUNTS += [("--trajectories", derivatives), ("--turns", throughput), ("--seeds", training)]
COMMANDS = [
    (distil, ["nobody"], "NAME must be one of .*, got 'nobody'"),
    (study, [], "NAME must be one or several of"),
    (study, ["direct-ppo", "--jobs", "0"], "--jobs must be an integer >= 1, got 0"),
    *(
        (each.main, [name, "0"], f"{name}: must be an integer >= 1, got '0'")
        for name, each in COUNTS
    ),
    (
        throughput.main,
        ["--figure", "nowhere/speed"],
        "--figure must name a file in a folder that exists, got 'nowhere",
    ),
    *(
        (identification.main, ["--amplitude", a], rf"--amplitude must be .* \(N m\), got {a}")
        for a in ("nan", "9.0")
    ),
    (
        fresh_draws.main,
        ["pd", "lqrr"],
        "lqrr: no results in lqrr.npz; `python -m agents.leaderboard NAME` writes",
    ),
    (study, ["direct-ppo", "--jobs", "2", "--backend", "ray"], "--jobs needs --backend loky"),
    (
        study,
        ["direct-ppo", "--backend", "ray"],
        "--backend ray needs Ray: pip install 'capsule-gym",
    ),
    (export, ["direct-ppo"], "at least one of --c and --onnx must be given"),
    (export, ["direct-ppo", "--law", "--c", "policy.h"], "--law needs a control law of the core"),
    (
        export,
        ["tests.capsule_gym.fakes:picky_controller", "--c", "policy.h"],
        "--law needs a control law of the core",
    ),
    (export, ["baselines:adaptive", "--onnx", "law.onnx"], "--onnx needs a policy"),
    (
        export,
        ["direct-ppo", "--onnx", "policy.h"],
        r"--onnx must be the name of a file \.onnx, got 'policy\.h'",
    ),
    (export, ["direct-pqo", "--c", "policy.h"], "name_or_path must be one of"),
    (
        export,
        ["direct-ppo", "--c", "policy.c"],
        "--c must be the name of a file .h, got 'policy.c'",
    ),
    (
        demo,
        ["adaptive", "--output", "film.mp4"],
        "--output must be the name of a GIF, got 'film.mp4'",
    ),
    (
        demo,
        ["adaptive", "--output", "nowhere/film.gif"],
        "--output must name a file in a folder that exists",
    ),
    (
        identify_file,
        [__file__, "--report", "fit"],
        r"--report must be the name of a file \.png or \.svg or \.pdf",
    ),
    (identify_file, ["nowhere.csv"], "log must be a file, got 'nowhere.csv'"),
    (demo, ["direct-po"], r"did you mean 'direct-ppo'\?"),
    (demo, ["adaptive", "--set", "papr"], r"got 'papr'; did you mean 'paper'\?"),
    (demo, ["adaptive", "--seed", "400"], "--seed must be one of the set's, 0 to 399, got 400"),
    (demo, ["adaptive", "--speed", "0"], "--speed must be a number from 0.1 to 20"),
    (demo, ["adaptive", "--rival", "keyboard", "-o", "out.gif"], "'keyboard' with --output"),
    (train, ["--total-steps", "inf"], "--total-steps: must be an integer >= 0, got 'inf'"),
    *(
        (train, ["--seed", text], f"--seed: must be an integer >= 0, got '{text}'")
        for text in ("abc", "1.5", "-3")
    ),
    (export, [], "(?i)required|missing"),
    (demo, ["adaptive", "--slow"], "--slow"),
    (
        demo,
        ["goal"],
        "policy must be for the task 'speed' of the set 'paper', got 'goal', which is for 'goal'",
    ),
    (train, ["--tota", "4"], "--tota"),
    (train, ["--wandb"], r'--wandb needs wandb: pip install "capsule-gym\[wandb\]"$'),
    (train, ["--resume", "nowhere"], "nowhere"),
    (train, ["--row", "fastest"], "--row: a row must be one of residual-ppo, "),
    (
        train,
        ["--row", "direct-ppo", "--task", "residual"],
        "--task must stay direct with --row direct-ppo,",
    ),
]


@pytest.mark.parametrize(
    ("main", "words", "message"), COMMANDS, ids=[message for *_, message in COMMANDS]
)
def test_an_invalid_command_line_ends_with_2_and_names_the_option(
    main, words, message, monkeypatch, tmp_path, capsys
):
    monkeypatch.chdir(tmp_path)
    for library in ("ray", "wandb"):
        monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert re.search(message, " ".join(re.sub("[│╭╮╰╯─]", "", capsys.readouterr().err).split()))
    assert not list(tmp_path.iterdir())


SHOOTING = "capsule_gym.identification.shooting"
MISSING = [
    ("jinja2", lambda: Exported("direct-ppo").c(), "--c needs jinja2"),
    ("onnx", lambda: Exported("direct-ppo").onnx(), "--onnx needs onnx"),
    ("matplotlib", lambda: style().__enter__(), "figures need matplotlib"),
    (
        "scipy.linalg",
        lambda: importlib.reload(importlib.import_module(SHOOTING)),
        "identify needs scipy",
    ),
    ("scipy.special", lambda: estimate(np.arange(12.0).reshape(3, 4)), "intervals need scipy"),
]
EXTRAS = {
    "baselines.tuning": "paper",
    "capsule_gym.demo": "render",
    "capsule_gym.export.__main__": "export",
    "capsule_gym.identification.__main__": "identify",
}


@pytest.mark.parametrize(
    ("library", "call", "message"), MISSING, ids=[library for library, *_ in MISSING]
)
def test_a_missing_library_is_named_with_its_extra(library, call, message, monkeypatch):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=rf"^{message}: pip install \"capsule-gym\[\w+\]\"$"):
        call()


@pytest.mark.parametrize(("name", "extra"), EXTRAS.items())
def test_a_command_without_tyro_names_the_extra_of_all_that_it_needs(name, extra, monkeypatch):
    monkeypatch.setitem(sys.modules, "tyro", None)
    monkeypatch.setitem(
        sys.modules, "__main__", SimpleNamespace(__spec__=SimpleNamespace(name=name))
    )
    with pytest.raises(ImportError, match=rf"needs tyro: pip install \"capsule-gym\[{extra}\]\"$"):
        importlib.reload(sys.modules["capsule_gym.command_line"])


def test_sources_that_are_not_compiled_are_named(tmp_path, monkeypatch):
    """A clone in whose folder Python finds them before an installed package."""
    (tmp_path / "sources").mkdir()
    shutil.copy(Path(native.__file__).with_name("__init__.py"), tmp_path / "sources")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        ImportError, match=r"sources contains no compiled core: .* pip install -e \.$"
    ):
        importlib.import_module("sources")


def test_the_first_cause_of_an_error_is_one_line():
    assert first_cause(ValueError("one\ntwo")) == "one"
    assert first_cause(ValueError("because of:\n\n two\nthree")) == "because of: two"
