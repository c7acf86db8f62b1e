"""Networks of torch and agents of Stable-Baselines3 as the arrays of a policy.

`Policy.from_torch` and `Policy.from_sb3` are the public functions.
"""

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import gymnasium as gym
import numpy as np

from capsule_gym.checks import require, short_repr
from capsule_gym.envs.config import EnvConfig
from capsule_gym.policies.network import Cell, Layer

# Largest size of a normalised input: no finite observation gives a NaN.
LARGEST_CLIP = 1e6
# The options of the environment that change the task of a policy, which observes an array.
NO_ARGUMENTS = ("threads", "render_mode", "goal_env")
# Modules of torch that leave values as they are, or at least those of a policy that acts.
NEUTRAL = ("Dropout", "Flatten", "Identity")
# Modules that may be empty and do nothing.
CONTAINERS = ("ModuleDict", "ModuleList", "Sequential")
ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu"}
# Wrappers of Stable-Baselines3 that change neither observations, but for their normalisation, nor
# actions.
VEC_WRAPPERS = ("VecCheckNan", "VecMonitor", "VecNormalize", "VecVideoRecorder")
AGENTS = "an agent of PPO, A2C, SAC, TD3, DDPG, TQC or RecurrentPPO"


def read_modules(modules: Iterable[Any], activation: str | None = None) -> dict[str, Any]:
    """The fields of `Policy` that describe a network.

    Args:
        modules: modules of torch in the order in which they are applied: linear layers, Tanh or
            ReLU after each hidden one, and at most one GRU or LSTM. A Tanh at the end squashes the
            action.
        activation: the activation of all hidden layers, "tanh" or "relu", if it is no module.

    Raises:
        ValueError: if a module is of another kind, or an activation is missing.
    """
    layers: list[Layer] = []
    head: list[Layer] = []
    cell = None
    found: list[str | None] = []  # an activation for each linear layer, or None
    for module in modules:
        kind = type(module).__name__
        if kind == "Linear":
            present = layers if cell is None else head
            present.append(_read_linear(module))
            found.append(None)
        elif kind in ("GRU", "LSTM"):
            require(cell is None, "module", "a network with at most one recurrent cell", module)
            cell = _read_cell(module)
        elif kind in ACTIVATIONS and found and found[-1] is None:
            found[-1] = ACTIVATIONS[kind]
        elif kind not in NEUTRAL:
            accepted = "Linear, Tanh or ReLU after a Linear, and at most one GRU or LSTM"
            raise ValueError(f"module must consist of {accepted}, got {module}")
    ends = head if cell is not None else layers
    require(bool(ends), "module", "a network whose last layer is linear", "no such layer")
    *hidden, last = found
    if activation is None:
        kinds = set(hidden) or {"tanh"}
        accepted = "a network with Tanh or with ReLU after every hidden layer"
        require(len(kinds) == 1 and None not in kinds, "module", accepted, hidden)
        activation = kinds.pop()
    accepted = "a network that ends with a linear layer or with Tanh"
    require(last in (None, "tanh"), "module", accepted, last)
    return {
        "layers": tuple(layers),
        "cell": cell,
        "head": tuple(head),
        "activation": activation,
        "squashing": "clip" if last is None else "tanh",
    }


def leaves(module: Any) -> list[Any]:
    """The modules without parts of a module of torch, in the order in which they are registered."""

    def is_leaf(part: Any) -> bool:
        return not any(part.children()) and type(part).__name__ not in CONTAINERS

    return list(filter(is_leaf, module.modules()))


def _read_linear(module: Any) -> Layer:
    """Copies of the weights and biases of a linear layer."""
    bias = np.zeros(module.out_features) if module.bias is None else _array(module.bias)
    return _array(module.weight), bias.astype(np.float32)


def _read_cell(module: Any) -> Cell:
    """Copies of the parameters of a GRU or an LSTM of one layer."""
    plain = module.num_layers == 1 and not module.bidirectional and module.proj_size == 0
    require(plain, "module", "a GRU or an LSTM of one layer and one direction", module)
    weight_ih = _array(module.weight_ih_l0)
    weight_hh = _array(module.weight_hh_l0)
    if not module.bias:
        zeros = np.zeros(len(weight_ih), np.float32)
        return Cell(weight_ih, weight_hh, zeros, zeros)
    return Cell(weight_ih, weight_hh, _array(module.bias_ih_l0), _array(module.bias_hh_l0))


def _array(parameter: Any) -> np.ndarray:
    """A copy of a parameter, float32."""
    return np.array(parameter.detach().cpu().numpy(), np.float32)


def read_agent(model: Any, env: Any) -> dict[str, Any]:
    """The fields of `Policy` that describe an agent's network and its inputs.

    Args:
        model: an agent of Stable-Baselines3 or sb3-contrib.
        env: its environment, with the `VecNormalize`, if any.

    Raises:
        TypeError: if the model is no agent of a known algorithm.
        ValueError: if its network or its space of actions is of another kind.
    """
    from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_normalize

    found = read_modules(_modules_of(model))
    if model.policy.squash_output:
        found["squashing"] = "tanh"
    normalisation = unwrap_vec_normalize(env) if isinstance(env, VecEnv) else None
    if normalisation is None or not normalisation.norm_obs:
        first = found["layers"][0][0] if found["layers"] else found["cell"].weight_ih
        return found | without_normalisation(first.shape[1])
    rms: Any = normalisation.obs_rms
    # With a privileged critic, the observations are dicts.
    if isinstance(rms, dict):
        rms = rms["policy"]
    found["mean"] = rms.mean.copy()
    found["variance"] = rms.var.copy()
    found["clip"] = float(normalisation.clip_obs)
    found["epsilon"] = float(normalisation.epsilon)
    return found


def without_normalisation(inputs: int) -> dict[str, Any]:
    """The fields of `Policy` that leave the inputs as they are."""
    return {
        "mean": np.zeros(inputs),
        "variance": np.ones(inputs),
        "clip": LARGEST_CLIP,
        "epsilon": 0.0,
    }


def _modules_of(model: Any) -> list[Any]:
    """The modules between the observation and the mean action of an agent, in order."""
    from capsule_gym.envs.sb3 import AsymmetricPolicy

    policy: Any = getattr(model, "policy", None)
    actor: Any = getattr(policy, "actor", None)
    if hasattr(policy, "action_net"):
        extractor = policy.pi_features_extractor
        modules = [*policy.mlp_extractor.policy_net, policy.action_net]
    elif hasattr(actor, "latent_pi"):
        extractor = actor.features_extractor
        modules = [*actor.latent_pi, actor.mu]
    elif hasattr(actor, "mu"):
        extractor = actor.features_extractor
        modules = list(actor.mu)
    else:
        raise TypeError(f"model must be {AGENTS}, got {type(model).__name__}")
    if hasattr(policy, "lstm_actor"):
        modules.insert(0, policy.lstm_actor)
    space = model.action_space
    unit = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
    require(space == unit, "model", f"an agent whose actions are {unit}", space)
    if isinstance(policy, AsymmetricPolicy):
        # The first module takes the agent's part of the features, which contain the critic's.
        return modules[1:]
    accepted = "an agent that takes the observation as it is, by FlattenExtractor"
    require(type(extractor).__name__ == "FlattenExtractor", "model", accepted, extractor)
    return modules


def read_env_kwargs(env: Any) -> dict[str, Any]:
    """The arguments with which an environment was made, but for those that are the defaults.

    Args:
        env: an environment of this package, a batch of it, or a `VecEnv` of Stable-Baselines3.

    Raises:
        TypeError: if it is no environment of this package.
        ValueError: if a wrapper changes observations or actions.
    """
    wrapper = env
    while (inner := getattr(wrapper, "venv", None)) is not None:
        kind = type(wrapper).__name__
        accepted = f"without other wrappers of batches than {', '.join(VEC_WRAPPERS)}"
        require(kind in VEC_WRAPPERS, "env", accepted, kind)
        wrapper = inner
    if hasattr(wrapper, "env_is_wrapped"):
        wrappers: tuple[type, ...] = (gym.ObservationWrapper, gym.ActionWrapper)
        for each in wrappers:
            changed = any(wrapper.env_is_wrapped(each))
            require(not changed, "env", f"without an {each.__name__}", "one")
    try:
        if hasattr(wrapper, "env_is_wrapped"):
            options = wrapper.get_attr("simulation")[0].options
        else:
            options = env.unwrapped.simulation.options
    except AttributeError:
        accepted = "an environment of this package"
        raise TypeError(f"env must be {accepted}, got {short_repr(env)}") from None
    usual = EnvConfig()
    given = {}
    for option in fields(EnvConfig):
        value = getattr(options, option.name)
        if option.name not in NO_ARGUMENTS and value != getattr(usual, option.name):
            given[option.name] = value
    return given
