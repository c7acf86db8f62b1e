"""Trained policies: one small file each, loaded without torch and without unpickling.

Their actions do not depend on the machine. A file is in the safetensors format:

| tensor | dtype | shape |
|---|---|---|
| `layers.0.weight`, `layers.1.weight`, .. | float32, as trained | (outputs, inputs) |
| `layers.0.bias`, `layers.1.bias`, .. | float32 | (outputs,) |
| `inputs.mean`, `inputs.variance` | float64 | (inputs,) |
| `cell.weight_ih`, `cell.bias_ih` | float32 | (gates * units, inputs), (gates * units,) |
| `cell.weight_hh`, `cell.bias_hh` | float32 | (gates * units, units), (gates * units,) |
| `head.0.weight`, `head.0.bias`, .. | float32 | as of `layers` |

Only recurrent policies have a cell, a GRU with 3 gates or an LSTM with 4, and a head after it. The
metadata are `format`, "capsule_gym policy", `format_version`, "2", or "3" with a cell, and the
fields of `Policy` by name, as text or JSON.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from safetensors.numpy import save

from capsule_gym.checks import (
    check_choice,
    check_integer,
    check_number,
    require,
    short_repr,
)
from capsule_gym.core import native
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.contract import entries_of
from capsule_gym.files import write_atomically
from capsule_gym.policies.conversion import (
    LARGEST_CLIP,
    NO_ARGUMENTS,
    leaves,
    read_agent,
    read_env_kwargs,
    read_modules,
    without_normalisation,
)
from capsule_gym.policies.network import Cell, Layer, check_array, check_cell, pack

POLICY = "policy.safetensors"
FORMAT = "capsule_gym policy"
FORMAT_VERSION = "2"
RECURRENT_VERSION = "3"
# The entries of a file's metadata that are plain text, and those that are JSON; `Policy` checks the
# values.
TEXTS = ("algorithm", "activation", "squashing", "revision")
VALUES = ("clip", "epsilon", "env_kwargs", "training_seed")
# Arguments of the training alone: an evaluation starts at rest.
TRAINING_STARTS = ("initial_noise", "initial_range")
# The algorithm of policies that imitate others, without a reward.
IMITATION = "dagger"
# Algorithms whose names in tables are not in capitals.
TITLES = {IMITATION: "DAgger", "recurrentppo": "Recurrent PPO"}
CHOICES = {"activation": ("tanh", "relu"), "squashing": ("clip", "tanh")}
# Largest size of a number in a memory: those of an LSTM grow by at most 1 in a step.
LARGEST_STATE = 1e9
# Within these limits no float32 weights give a sum beyond float64, and no finite observation gives
# a NaN.
MOST_LAYERS = 6
MOST_UNITS = 1024
SMALLEST_VARIANCE = 1e-300
ENV_ARGUMENTS = tuple(each.name for each in fields(EnvConfig) if each.name not in NO_ARGUMENTS)


class Act(Protocol):
    """A function from observations to actions, of `Policy.start`."""

    def __call__(self, observations: np.ndarray, starts: np.ndarray | None = None) -> np.ndarray:
        """The actions; the memory of the episodes that start is cleared before."""


@dataclass(frozen=True, eq=False)
class Policy:
    """A trained, deterministic policy: `policy(observation)` returns the action.

    The action for an observation is the same bit for bit alone, in any batch and on any processor.

    Attributes:
        name: name in messages and tables.
        algorithm: training algorithm: "ppo", "sac", "td3", "tqc", "dagger".
        layers: weights (outputs, inputs) and biases (outputs,) of each layer, float32; the last has
            one output. In a recurrent policy these are the layers before the cell, if any, each
            with the activation.
        activation: activation of the hidden layers, "tanh" or "relu".
        squashing: function that limits the output to [-1, 1], "clip" or "tanh".
        mean: mean of the inputs, which are the entries of the observation, in training, shape
            (entries,), float64.
        variance: their variance; an input i becomes (i - mean) / sqrt(variance + epsilon), kept
            within +-clip.
        clip: see `variance`.
        epsilon: see `variance`.
        env_kwargs: arguments of the training environment without its random starts, for `gym.make`
            with the id of the policy's task.
        training_seed: seed of the training run.
        revision: git revision of the training code.
        cell: the recurrent cell; None for a policy without a memory.
        head: the layers after the cell; the last has one output. The first reads the output of the
            cell, and may read the normalised inputs after it.
        entries: number of entries of an observation.

    Raises:
        TypeError: if a field is of the wrong type.
        ValueError: if a field is out of range, or the shapes do not fit each other or the
            environment's observation.
    """

    name: str
    algorithm: str
    layers: tuple[Layer, ...] = field(repr=False)
    activation: str
    squashing: str
    mean: np.ndarray = field(repr=False)
    variance: np.ndarray = field(repr=False)
    clip: float
    epsilon: float
    env_kwargs: dict[str, Any]
    training_seed: int
    revision: str
    cell: Cell | None = field(default=None, repr=False)
    head: tuple[Layer, ...] = field(default=(), repr=False)
    entries: int = field(init=False)
    _network: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check_words_and_numbers()
        options = self._check_env_kwargs()
        object.__setattr__(self, "entries", len(entries_of(options)))
        self._check_arrays()
        network = pack(
            self.layers,
            self.mean,
            1.0 / np.sqrt(self.variance + self.epsilon),
            cell=self.cell,
            head=self.head,
            relu=self.activation == "relu",
            tanh_squashing=self.squashing == "tanh",
            clip=self.clip,
        )
        object.__setattr__(self, "_network", network)

    @classmethod
    def from_torch(
        cls,
        module: Any,
        *,
        env_kwargs: dict[str, Any] | None = None,
        activation: str | None = None,
        squashing: str | None = None,
        mean: np.ndarray | None = None,
        variance: np.ndarray | None = None,
        name: str = "torch",
    ) -> "Policy":
        """Makes a policy of a network of torch.

        The network consists of linear layers, Tanh or ReLU after each hidden one, and at most one
        GRU or LSTM of one layer, registered in the order in which they are applied. Dropout,
        Flatten and Identity are left out. The first layer after the GRU or LSTM may read the
        normalised observation after its output.

        Args:
            module: a `torch.nn.Module`. Its `forward` is not called.
            env_kwargs: arguments of the environment, for `gym.make`.
            activation: activation of all hidden layers, "tanh" or "relu", where `forward` applies
                functions instead of modules.
            squashing: function that limits the output to [-1, 1], "clip" or "tanh"; None takes
                "tanh" if the network ends with it, else "clip".
            mean: mean of the observation's entries, which is subtracted; None for 0.
            variance: their variance, by whose root they are divided; None for 1.
            name: name in messages and tables.

        Raises:
            ValueError: if a module is of another kind, or the shapes do not fit.
        """
        found = read_modules(leaves(module), activation)
        if squashing is not None:
            found["squashing"] = squashing
        entries = len(entries_of(EnvConfig(**(env_kwargs or {}))))
        found |= without_normalisation(entries)
        if mean is not None:
            found["mean"] = np.array(mean, np.float64)
        if variance is not None:
            found["variance"] = np.array(variance, np.float64)
        return cls(
            name=name,
            algorithm="torch",
            env_kwargs=env_kwargs or {},
            training_seed=0,
            revision="unknown",
            **found,
        )

    @classmethod
    def from_sb3(cls, model: Any, env: Any = None, *, name: str | None = None) -> "Policy":
        """Makes a policy of an agent of Stable-Baselines3 or sb3-contrib, which acts as its mean.

        Args:
            model: an agent of PPO, A2C, SAC, TD3, DDPG or TQC with "MlpPolicy", or of RecurrentPPO
                with "MlpLstmPolicy".
            env: the environment of the training, with its `VecNormalize`, if any; None takes the
                model's own.
            name: name in messages and tables; None takes the algorithm's.

        Raises:
            TypeError: if the model is another one, or `env` is no environment of this package.
            ValueError: if the network is of another kind, or a wrapper changes observations or
                actions.
        """
        if env is None:
            env = getattr(model, "env", None)
        found = read_agent(model, env)
        require(env is not None, "env", "the environment of the training", env)
        algorithm = type(model).__name__.lower()
        return cls(
            name=name or algorithm,
            algorithm=algorithm,
            env_kwargs=read_env_kwargs(env),
            training_seed=model.seed or 0,
            revision=f"stable-baselines3 {version('stable-baselines3')}",
            **found,
        )

    def _check_words_and_numbers(self) -> None:
        for name, choices in CHOICES.items():
            check_choice(name, getattr(self, name), choices, f"one of {choices}")
        for name in ("algorithm", "revision"):
            value = getattr(self, name)
            fits = isinstance(value, str) and value != ""
            require(fits, name, "a string that is not empty", value, TypeError)
        accepted = "an integer from 0 to 2**63 - 1"
        check_integer("training_seed", self.training_seed, accepted, 0, 2**63 - 1)
        accepted = f"a number in (0, {LARGEST_CLIP:g}]"
        check_number("clip", self.clip, accepted, 0.0, LARGEST_CLIP, open_low=True)
        check_number("epsilon", self.epsilon, "a finite number >= 0", 0.0)

    def _check_env_kwargs(self) -> EnvConfig:
        """Makes objects of the JSON in `env_kwargs`, and returns the options of the environment."""
        kwargs = self.env_kwargs
        accepted = f"a dict with keys out of {ENV_ARGUMENTS}"
        require(isinstance(kwargs, dict), "env_kwargs", accepted, kwargs, TypeError)
        require(set(kwargs) <= set(ENV_ARGUMENTS), "env_kwargs", accepted, list(kwargs))
        options = EnvConfig(**kwargs)
        # EnvConfig has made objects and tuples of the dicts and lists that JSON contains.
        parsed = {
            key: getattr(options, key) if type(value) in (dict, list) else value
            for key, value in kwargs.items()
            if key not in TRAINING_STARTS
        }
        object.__setattr__(self, "env_kwargs", parsed)
        law, task = options.controller, options.task
        named = law is None or isinstance(law, str)
        require(named, "env_kwargs['controller']", "None or an import string", law, TypeError)
        require(isinstance(task, str), "env_kwargs['task']", "the name of a task", task, TypeError)
        return options

    def _check_arrays(self) -> None:
        accepted = "one for each entry of the observation by env_kwargs"
        for name in ("mean", "variance"):
            array = getattr(self, name)
            check_array(f"inputs.{name}", array, np.float64, (self.entries,), accepted)
        if self.cell is None:
            require(not self.head, "head", "empty without a cell", len(self.head))
            self._check_layers("layers", self.layers, self.entries, last=True)
        else:
            width = self._check_layers("layers", self.layers, self.entries, last=False)
            width = check_cell(self.cell, width)
            if self.head and self.head[0][0].shape[1:] == (width + self.entries,):
                width += self.entries
            self._check_layers("head", self.head, width, last=True)
        divisible = self.variance + self.epsilon >= SMALLEST_VARIANCE
        fits = bool((divisible & (self.variance >= 0.0)).all())
        require(fits, "inputs.variance", ">= 0, and with epsilon > 0", self.variance)

    def _check_layers(self, name: str, layers: Sequence[Layer], width: int, *, last: bool) -> int:
        """Checks layers after `width` values, and returns how many values they put out."""
        least = 1 if last else 0
        most = MOST_LAYERS if self.cell is None else MOST_LAYERS // 2
        count = len(layers)
        require(least <= count <= most, name, f"{least} to {most} layers", count)
        accepted = f"with 1 to {MOST_UNITS} units in a layer"
        if last:
            accepted += ", and one in the last"
        for n, (weights, bias) in enumerate(layers):
            ends = last and n == count - 1
            units = 1 if ends else min(max(1, bias.size), MOST_UNITS)
            check_array(f"{name}.{n}.bias", bias, np.float32, (units,), accepted)
            check_array(f"{name}.{n}.weight", weights, np.float32, (units, width), accepted)
            width = units
        return width

    @property
    def memory_size(self) -> int:
        """Numbers in the memory of an episode; 0 for a policy without a memory."""
        return native.call("memory_size", self._network)

    @property
    def description(self) -> str:
        """A description in one line."""
        options = EnvConfig(**self.env_kwargs)
        action = "the whole torque"
        if options.controller is not None:
            limit = options.residual_limit or options.torque_limit
            action = f"a residual torque of up to {limit:g} N m on `{options.controller}`"
            if options.total_torque:
                action += ", as total torque"
        algorithm = TITLES.get(self.algorithm, self.algorithm.upper())
        return f"{algorithm}, {action}, trained with randomization {options.randomization}"

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """The action in [-1, 1] for an observation, or the actions for several.

        Args:
            observation: shape (entries,) or (n, entries).

        Returns:
            Float32, shape (1,) or (n, 1).

        Raises:
            TypeError: if the policy is recurrent: `start` gives every episode a memory.
            ValueError: if the observation has another shape or is not finite.
        """
        if self.cell is not None:
            raise TypeError(
                f"policy must be called as act = policy.start(seeds) and act(observations), which "
                f"keeps a memory for every episode, got a call of the recurrent {self.name!r}"
            )
        return self._act(observation, None)

    def _read_observation(self, observation: Any) -> np.ndarray:
        """A valid observation, shape (entries,), or a batch, shape (n, entries), as float32."""
        try:
            array = np.require(observation, np.float32, ["C", "A"])
        except (TypeError, ValueError, OverflowError) as error:
            got = f"{short_repr(observation)}: {error}"
            raise ValueError(f"observation must be an array of finite numbers, got {got}") from None
        has_shape = array.ndim in (1, 2) and array.shape[-1] == self.entries
        if not has_shape or not np.isfinite(array).all():
            accepted = f"finite and of shape ({self.entries},) or (n, {self.entries})"
            raise ValueError(f"observation must be {accepted}, got {short_repr(observation)}")
        return array

    def _act(self, observation: np.ndarray, memory: np.ndarray | None) -> np.ndarray:
        """The actions for observations; renews the memory, shape (n, memory_size), of a batch."""
        array = self._read_observation(observation)
        rows = array.reshape(-1, self.entries)
        if memory is not None and len(rows) != len(memory):
            accepted = f"one row for each of {len(memory)} episodes"
            raise ValueError(f"observations must have {accepted}, got {len(rows)} rows")
        actions = np.empty((len(rows), 1), np.float32)
        # Threads may share the network.
        kept = 0 if memory is None else memory
        native.call("act", self._network, rows, kept, len(rows), actions)
        return actions if array.ndim == 2 else actions[0]

    def start(self, seeds: Sequence[int]) -> Act:
        """Begins a batch of episodes, one per seed, as for scripted policies.

        A trained policy draws no random numbers. A recurrent one keeps a memory for every episode.

        Returns:
            The function from observations (episodes, entries) to actions (episodes, 1), or from
            (entries,) of a single episode to (1,). Call it once per step. Its optional argument
            `starts`, bool of shape (episodes,), says which episodes begin with these observations:
            their memory is cleared. It is not needed where all episodes begin together, with the
            first call. It raises the same ValueError as the policy.
        """
        memory = native.aligned_zeros((len(seeds), self.memory_size))

        def act(observations: np.ndarray, starts: np.ndarray | None = None) -> np.ndarray:
            if starts is not None:
                _clear(memory, "starts", starts)
            return self._act(observations, memory)

        return act

    def predict(
        self,
        observation: np.ndarray,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """The actions in the convention of Stable-Baselines3, as `evaluate_policy` calls it.

        Args:
            observation: shape (entries,) or (n, entries).
            state: the second result of the last call; None starts every episode.
            episode_start: which episodes begin with this step, bool, shape (n,).
            deterministic: must be True.

        Returns:
            The actions, float32, shape (1,) or (n, 1), and the memory of a recurrent policy.

        Raises:
            ValueError: as for a call of the policy; or if `deterministic` is False.
        """
        require(bool(deterministic), "deterministic", "True", deterministic)
        if self.cell is None:
            return self(observation), None
        array = self._read_observation(observation)
        episodes = len(np.atleast_2d(array))
        memory = native.aligned_zeros((episodes, self.memory_size))
        if state is not None:
            memory[:] = _read_state(state, memory.shape)
        if episode_start is not None:
            _clear(memory, "episode_start", episode_start)
        return self._act(array, memory), (memory,)

    def save(self, path: str | Path) -> None:
        """Writes the policy file atomically. The same policy gives the same bytes."""
        tensors = {"inputs.mean": self.mean, "inputs.variance": self.variance}
        for n, (weights, bias) in enumerate(self.layers):
            tensors[f"layers.{n}.weight"] = weights
            tensors[f"layers.{n}.bias"] = bias
        if self.cell:
            for name, array in self.cell._asdict().items():
                tensors[f"cell.{name}"] = array
        for n, (weights, bias) in enumerate(self.head):
            tensors[f"head.{n}.weight"] = weights
            tensors[f"head.{n}.bias"] = bias
        # Versions of this package without recurrent policies read the files of all others.
        number = RECURRENT_VERSION if self.cell else FORMAT_VERSION
        metadata = {"format": FORMAT, "format_version": number}
        for name in TEXTS:
            metadata[name] = getattr(self, name)
        values = vars(self) | {"clip": float(self.clip), "epsilon": float(self.epsilon)}
        for key in VALUES:
            metadata[key] = json.dumps(values[key], default=_plain, sort_keys=True, allow_nan=False)
        content = save(tensors)
        # The library writes metadata in a random order, which would change the file's hash.
        end = 8 + int.from_bytes(content[:8], "little")
        header = {"__metadata__": dict(sorted(metadata.items())), **json.loads(content[8:end])}
        text = json.dumps(header, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 8)
        size = len(text).to_bytes(8, "little")
        write_atomically(Path(path), size + text + content[end:])


def _plain(value: Any) -> Any:
    """A number of numpy or an object of an option, as JSON contains it."""
    return value.item() if isinstance(value, np.generic) else asdict(value)


def _read_state(state: Any, shape: tuple[int, ...]) -> np.ndarray:
    """The memory in a state of `Policy.predict`."""
    memory = state[0] if isinstance(state, tuple) and len(state) == 1 else None
    if not isinstance(memory, np.ndarray) or memory.dtype.kind != "f":
        memory = np.zeros(0)
    # NaN is not within the limits.
    fits = memory.shape == shape and bool((np.abs(memory) <= LARGEST_STATE).all())
    accepted = f"None or a tuple of an array of shape {shape}, float, within +-{LARGEST_STATE:g}"
    require(fits, "state", accepted, state)
    return memory


def _clear(memory: np.ndarray, name: str, starts: Any) -> None:
    """Clears the memory of the episodes that begin, by the argument with this name."""
    try:
        begins = np.asarray(starts)
    except (TypeError, ValueError):
        begins = np.zeros(0)
    fits = begins.dtype == bool and begins.shape == (len(memory),)
    require(fits, name, f"an array of bool of shape ({len(memory)},)", starts)
    memory[begins] = 0.0
