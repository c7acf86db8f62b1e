"""Invalid arguments of environments, plants and control laws: the error names them."""

import numpy as np
import pytest

from agents.training.algorithms import make_env
from agents.training.config import Config, RunError
from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv, Randomization, dynamics
from capsule_gym.control.controller import Controller, CoreLaw
from capsule_gym.control.laws.adaptive import adaptive
from capsule_gym.control.laws.feedback_linearisation import feedback_linearising
from capsule_gym.control.laws.gains import known_parameters
from capsule_gym.control.laws.gait import gait
from capsule_gym.control.laws.profiles import TABLE_1, TABLE_1_EPC, seven_phases, six_phases
from capsule_gym.core import native
from capsule_gym.parameters import Disturbances
from capsule_gym.sb3 import CapsuleSB3VecEnv
from capsule_gym.tasks.task import Task

SLOW = Controller("slow", lambda *numbers: (0.0, numbers[4]), np.zeros((1, 2)), dt=2000.0)
REAL = CapsuleEnv(disturbances="real")
GOALS = CapsuleEnv(task="goal", goal_env=True)
FLOORS = Randomization(mu=(0.01, 0.1))
ORIGIN = (0.0, 0.0, 0.0, 0.0)
OSCILLATOR = dict.fromkeys(("omega", "alpha", "bias", "K_theta", "K_theta_dot", "dt"), 1.0)
OSCILLATOR |= dict.fromkeys(("E_a", "E_b", "real", "imaginary"), (1.0, 2.0, 3.0))
GAIT = known_parameters("gait")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"render_mode": np.array(["human", "human"])}, "render_mode must be"),
        ({"capsule": {"wheels": 4}}, "^capsule must have fields out of .*, got 'wheels'"),
        ({"randomization": Randomization(M=(0.001, 0.5), mu=(5.0, 20.0))}, "Painleve"),
        ({"task": "fast"}, r"^task must be a Task or one of \[.*'speed'.*\], got "),
        ({"task": Task(name="run")}, r"task\.name must be .*'speed'.*got 'run'"),
        ({"residual_limit": 0.0}, "^residual_limit must be > 0"),
        ({"stack_size": 101}, "^stack_size must be an integer from 1 to 100, got 101"),
        ({"physics_dt": 0.003}, "^physics_dt must be control_dt=0.02 s over .*, got 0.003"),
        (
            {"control_dt": 1e-5, "physics_dt": 3e-6},
            "^physics_dt must be control_dt=1e-05 s over .*, got 3e-06",
        ),
        (
            {"control_dt": 0.0205, "controller": adaptive},
            r"^the controller's dt must be control_dt=0\.0205 s over .*, got 0\.001",
        ),
        ({"disturbances": Disturbances(motor_friction=100.0)}, "^physics_dt must be at most"),
        ({"initial_noise": 0.6}, r"^initial_noise must be .*, at most 0\.5, got 0\.6"),
        ({"physics_dt": 1e-25}, r"^physics_dt must be .*>= 1e-09 \(s\).*, got 1e-25"),
        ({"physics_dt": 1e-9, "controller": adaptive}, "^control_dt must be at most 1000000 times"),
        ({"control_dt": 1e6}, r"^control_dt must be at most 1000000 times physics_dt=0\.002 s,"),
        ({"control_dt": 1e300}, r"^control_dt must be .* \(s\), at most 1e\+06, got 1e\+300"),
        ({"controller": SLOW}, "^physics_dt must be the law's step=2000.0 s over "),
        ({"initial_range": (np.pi / 2, 0.0)}, r"^initial_range must be None or .*, got 1\.57"),
        ({"initial_range": (-0.1, 0.0)}, r"^initial_range must be .* >= 0, got -0\.1"),
        ({"initial_range": (0.0, 1e4)}, r"^initial_range must be .* <= 1000 .*, got 10000\.0"),
        ({"initial_range": (np.nan, 0.0)}, "^initial_range must be .*, got nan"),
        (
            {"initial_range": (0.1, 0.1), "initial_noise": 0.1},
            "initial_noise must be 0 .*got 0.1",
        ),
        ({"capsule": Capsule(M=1.0, mu=0.2)}, r"^capsule\.M .*randomization='none'.*, got 1\.0"),
        ({"capsule": Capsule(M=0.5, mu=0.2)}, r"^capsule\.mu .*randomization='none'.*, got 0\.2"),
        (
            {"capsule": Capsule(m=0.2), "randomization": "real"},
            r"^capsule\.m must be left out where .* m in \[0\.1242, 0\.1518\].*, got 0\.2",
        ),
        ({"capsule": Capsule(M=1.0), "task": "goal"}, r"^capsule\.M must be left out where"),
        ({"total_torque": True}, "^total_torque must be False without a controller.*, got True$"),
        (
            {"total_torque": True, "residual_limit": 1.5},
            "^total_torque must be False without a controller",
        ),
        (
            {"total_torque": True, "residual_limit": 3.0},
            "^total_torque must be False without a controller",
        ),
        (
            {"disturbances": Disturbances(controls="law")},
            r"^disturbances\.controls must be 'both' or 'agent' without a controller, got 'law'",
        ),
        ({"task": "velocity", "goal_env": True}, "^goal_env must be False for the task 'vel"),
    ],
)
def test_an_invalid_argument_of_the_environment_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        CapsuleEnv(**arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        {"capsule": Capsule(M=1.0, mu=0.2), "randomization": "none"},
        {"capsule": Capsule(M=1.0, static_ratio=1.3), "randomization": FLOORS},
        {"capsule": Capsule(M=0.8), "randomization": Randomization(M=(0.7, 0.9))},
        {"capsule": Capsule(m=0.2, static_ratio=1.3)},
        {"total_torque": True, "residual_limit": 1.0},
        {"total_torque": True, "controller": "baselines:pd"},
        {"disturbances": Disturbances(controls="law"), "controller": "baselines:pd"},
        {"disturbances": Disturbances(controls="agent")},
    ],
)
def test_an_argument_that_has_an_effect_beside_another_is_accepted(arguments):
    CapsuleEnv(**arguments).reset(seed=0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tusk": "goal"}, "unexpected keyword argument 'tusk'; did you mean 'task'"),
        ({"mu": 0.1}, r"'mu'; every reset draws it from randomization=Randomization\(mu="),
        ({"task": 1}, r"^task must be a Task or one of \[.*'speed'.*\], got "),
        ({"randomization": {"M": 0.5}}, "^randomization: Randomization.M must be a pair"),
    ],
)
def test_an_unknown_argument_or_a_wrong_type_is_named(arguments, message):
    with pytest.raises(TypeError, match=message):
        CapsuleEnv(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"max_episode_steps": 0}, "max_episode_steps must be an integer >= 1, or -1"),
        ({"max_episode_steps": -2}, "max_episode_steps must be .*, got -2"),
        ({"render_mode": "human"}, "render_mode of a batch must be None or"),
    ],
)
def test_an_invalid_argument_of_a_batch_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        CapsuleVectorEnv(2, **arguments)


def test_an_object_that_is_no_wrapper_is_named():
    with pytest.raises(RunError, match=r"--wrapper .* not a subclass of"):
        make_env(Config(wrapper=("builtins:int",)), 0)


@pytest.mark.parametrize("kind", [Capsule, Config, Disturbances, Randomization])
def test_fields_are_given_by_name(kind):
    with pytest.raises(TypeError, match="positional"):
        kind(0.5)


@pytest.mark.parametrize(
    ("kind", "fields", "message"),
    [
        (Capsule, {"slope": 1.51}, r"slope must be a finite number from -1\.5 to 1\.5, got 1\.51"),
        (Capsule, {"normal_force": "none"}, "normal_force must be 'newton' or 'paper', got 'none'"),
        (Randomization, {"mu": (-0.1, 0.1)}, r"mu\[0\] must .* 0 <= low"),
        (Randomization, {"stribeck_speed": (0.0, 0.1)}, r"stribeck_speed\[0\] must .* 0 < l"),
        (Randomization, {"M": (0.2, 0.1)}, r"M must be a pair \(low, high\) of"),
        # Zero is a friction coefficient, but no mass, and has no logarithm.
        (Randomization, {"M": (0.0, 1.0)}, r"M\[0\].*0 < low"),
        (
            Randomization,
            {"mu": (5e-324, 0.1), "log_mu": True},
            "mu must be within a factor .*5e-324",
        ),
        (Randomization, {"log_mu": True}, "log_mu must be False without a range of mu, got True"),
        (Disturbances, {"latency": -1.0}, r"latency must be a .* 0 to 0\.5, or .*-1"),
        (Disturbances, {"x_dot_latency": 0.6}, r"x_dot_latency must be a .* 0 to 0\.5, or .*0\.6"),
        (Disturbances, {"jitter": -1e-3}, r"jitter must be a .* 0 to 0\.5, or .*-0\.001"),
        (Disturbances, {"lost": (0.0, 1.5)}, r"lost\[1\] must be a number from 0 to 1, .*1\.5"),
        (Disturbances, {"hold": float("nan")}, r"hold must be a number from 0 to 1000, .* got nan"),
        (Disturbances, {"x_noise": -1.0}, "x_noise must be None or a number .* 1000, got -1"),
        (Disturbances, {"stick_threshold": -1.0}, "stick_threshold must be a number .*, got -1"),
        (Disturbances, {"controls": "none"}, "controls must be 'both', .*, got 'none'"),
        (Disturbances, {"unmeasured": ("x",)}, r"unmeasured must be .* got \('x',\)"),
    ],
)
def test_an_invalid_parameter_is_named(kind, fields, message):
    with pytest.raises(ValueError, match=rf"^{kind.__name__}\.{message}"):
        kind(**fields)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: GOALS.compute_reward([0.1, 0.0], [0.1], {}),
            r"^desired_goal must be .*, got \[0\.1\]$",
        ),
        (
            lambda: REAL.reset(options={"disturbances": {"latency": 0.1}}),
            r"must be .* 0 to 0\.016, got 0\.1",
        ),
        (
            lambda: REAL.reset(options={"disturbances": {"jitter": 0.1}}),
            r"must be a number from 0 to 0, got 0\.1",
        ),
        (
            lambda: REAL.reset(options={"disturbances": {"speed": 0.1}}),
            "must be a dict with keys out of",
        ),
        (
            lambda: CapsuleVectorEnv(3).reset(seed=2**128 - 2),
            r"^seed must be .* from 0 to 2\*\*128 - 3, None",
        ),
        (lambda: CapsuleVectorEnv(3).reset(seed=[1, 2]), r"^seed must be .* a sequence of 3 "),
        (
            lambda: CapsuleSB3VecEnv(2, 0, privileged=True, task="goal", goal_env=True),
            "privileged must be",
        ),
        (lambda: native.address(np.zeros((2, 2))[:, 0]), "array must be C-contiguous"),
        (lambda: CoreLaw("odd"), "name must be one of none, adaptive, .*, got 'odd'"),
        (
            lambda: CoreLaw("oscillator", **OSCILLATOR | {"real": 1.0}),
            "real must be 3 numbers, got",
        ),
        (
            lambda: CoreLaw("oscillator", **OSCILLATOR | {"real": (1.0, np.nan, 3.0)}),
            "real must be 3 numbers, got",
        ),
        (lambda: CoreLaw("none")(*ORIGIN, (0.0, 0.0), (0.0, 0.0)), "must have the shapes"),
        (lambda: adaptive(K1=-1.0), "K1 must be"),
        (lambda: adaptive(n=1001), "n must be an integer from 1 to 1000, got 1001"),
        (lambda: adaptive(beta=0.0), "beta must be a finite number > 0"),
        (lambda: adaptive(eta_0=0.0), "eta_0 must be a number > 0 and <= 10, got 0"),
        (lambda: adaptive(eta_0=10.1), "eta_0 must be a number > 0 and <= 10, got 10.1"),
        (lambda: adaptive(dt=7e-4), "multiple of dt"),
        (lambda: gait([1.0]), r"parameters must be 23 numbers, phi_000, .*, got \[1.0\]"),
        (
            lambda: gait((*GAIT[:-1], np.nan)),
            "parameters, guard_from, must be a finite number, got nan",
        ),
        (lambda: seven_phases(TABLE_1[:2], 7.8, 2.1), "t1 to t7"),
        (lambda: seven_phases((0.2, 0.1, *TABLE_1[2:]), 7.8, 2.1), "must increase"),
        (lambda: six_phases(TABLE_1_EPC, 1.0, 1.4), "P2 must be"),
        (lambda: feedback_linearising(K_p=np.nan), "K_p must be"),
        (
            lambda: feedback_linearising(seven_phases((*TABLE_1[:-1], 6.60005), 7.8, 2.1)),
            "multiple",
        ),
    ],
)
def test_an_invalid_value_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: CapsuleSB3VecEnv(2, "a"), "seed must be an integer .*, got 'a'"),
        (
            lambda: REAL.reset(options={"capsule": 0.1}),
            r"^options\['capsule'\] must be a dict with keys out of .*, got 0\.1",
        ),
        (lambda: dynamics.contact_phase(*ORIGIN, Capsule()), "plant must be a Plant, such as"),
        (lambda: Controller(5, len, np.zeros((1, 2))), "Controller.name must be a string, got 5"),
        (
            lambda: Randomization(log_mu=1),
            "^Randomization.log_mu must be True or False, got 1",
        ),
        (lambda: Randomization(mu=(True, 2.0)), r"^Randomization\.mu.* a pair \(low, high\)"),
        (
            lambda: CoreLaw("oscillator"),
            "'oscillator' takes the constants omega, .*, dt, got $",
        ),
        (
            lambda: CoreLaw("oscillator", **OSCILLATOR, K=1.0),
            "the constants omega, .*, got .*, K$",
        ),
        (lambda: adaptive(regularised=1), "regularised must be True or False, got 1"),
        (
            lambda: gait(("1", *GAIT[1:])),
            "parameters, phi_000, must be a finite number, got '1'",
        ),
    ],
)
def test_a_value_of_a_wrong_type_is_named(call, message):
    with pytest.raises(TypeError, match=message):
        call()
