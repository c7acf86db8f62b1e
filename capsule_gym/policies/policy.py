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
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from capsule_gym.checks import (
    check_choice,
    check_integer,
    check_number,
    nearest,
    require,
    short_repr,
    shortened,
)
from capsule_gym.control.lookup import is_own
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
from capsule_gym.policies.network import CELLS, Cell, Layer, pack

POLICY = "policy.safetensors"
# The policies that come with the package.
FOLDER = Path(__file__).parents[1] / "data" / "policies"
FORMAT = "capsule_gym policy"
FORMAT_VERSION = "2"
RECURRENT_VERSION = "3"
# The entries of a file's metadata that are plain text, and those that are JSON; `Policy` checks the
# values.
TEXTS = ("algorithm", "activation", "squashing", "revision")
VALUES = ("clip", "epsilon", "env_kwargs", "training_seed")
# The algorithm of policies that imitate others, without a reward.
IMITATION = "dagger"
# Algorithms whose names in tables are not in capitals.
TITLES = {IMITATION: "DAgger", "recurrentppo": "Recurrent PPO"}
CHOICES = {"activation": ("tanh", "relu"), "squashing": ("clip", "tanh")}
# Of a recurrent cell: its sums for several environments lie on the stack.
MOST_CELL_UNITS = 512
# Largest size of a number in a memory: those of an LSTM grow by at most 1 in a step.
LARGEST_STATE = 1e9
# Within these limits no float32 weights give a sum beyond float64, and no finite observation gives
# a NaN.
MOST_LAYERS = 6
MOST_UNITS = 1024
SMALLEST_VARIANCE = 1e-300
# The first bytes of an archive.
ZIP = b"PK\3\4"
# Largest file that is read, bytes: larger than any file within the limits above, many times larger
# than usual.
LARGEST_FILE = 32 * 2**20
ENV_ARGUMENTS = tuple(each.name for each in fields(EnvConfig) if each.name not in NO_ARGUMENTS)


def policy_names(*, seeds: bool = False) -> list[str]:
    """The names of the policies that come with the package.

    Args:
        seeds: give the names of all their training runs instead, such as "residual-ppo/seed-2".
    """
    return [name for name in pretrained() if ("/" in name) is seeds]


@lru_cache(maxsize=1)
def pretrained() -> dict[str, Path]:
    """The files of the policies that come with the package, by name.

    Every run has a name; the plain name means the first run.
    """

    def row_and_seed(file: Path) -> tuple[str, int]:
        row, run = file.parts[-3:-1]
        return row, int(run.removeprefix("seed-"))

    found: dict[str, Path] = {}
    for file in sorted(FOLDER.glob(f"*/seed-*/{POLICY}"), key=row_and_seed):
        row, run = file.parts[-3:-1]
        found.setdefault(row, file)
        found[f"{row}/{run}"] = file
    return found


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
        env_kwargs: arguments of the training environment, for `gym.make` with the id of the
            policy's task.
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
        found = read_agent(model, env)
        env = model.get_env() if env is None else env
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
            _check_array(f"inputs.{name}", array, np.float64, (self.entries,), accepted)
        if self.cell is None:
            require(not self.head, "head", "empty without a cell", len(self.head))
            self._check_layers("layers", self.layers, self.entries, last=True)
        else:
            width = self._check_layers("layers", self.layers, self.entries, last=False)
            width = _check_cell(self.cell, width)
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
            _check_array(f"{name}.{n}.bias", bias, np.float32, (units,), accepted)
            _check_array(f"{name}.{n}.weight", weights, np.float32, (units, width), accepted)
            width = units
        return width

    @property
    def memory_size(self) -> int:
        """Numbers in the memory of an episode; 0 for a policy without a memory."""
        return self.cell.memory_size if self.cell else 0

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


def _law_named(name: str) -> str:
    """The end of the message for the name of a control law, or an empty string."""
    from capsule_gym.control.laws import LAWS

    law = name.replace("-", "_")
    if law not in LAWS:
        return ""
    return f", which is a control law: gym.make(.., controller='baselines:{law}')"


def load_policy(name_or_path: str | os.PathLike[str], *, trust_controller: bool = False) -> Policy:
    """Loads a trained policy.

    A policy file contains no pickled objects and no code.

    Args:
        name_or_path: a name of `policy_names()`, which is the training run with the lowest seed;
            one run, such as "residual-ppo/seed-2"; the path of a policy file; or the folder of a
            training run, whose best policy is loaded.
        trust_controller: accept a policy with a control law outside this package. The environment
            imports the law, which runs its code.

    Raises:
        TypeError: if `name_or_path` is neither a string nor a path.
        ValueError: if there is no such policy, the file is corrupt, or it names a law that is not
            trusted.
    """
    named = isinstance(name_or_path, (str, os.PathLike))
    require(named, "name_or_path", "a policy's name or a path", name_or_path, TypeError)
    name = str(name_or_path)
    path = pretrained().get(name) if isinstance(name_or_path, str) else None
    if path is None:
        path = _find_file(name_or_path)
        folder = path.absolute().parent
        if folder.name == "best":
            folder = folder.parent
        # As `policy_names` names a row's run.
        name = "/".join(folder.parts[-2:]) if folder.name.startswith("seed-") else folder.name
    size = path.stat().st_size
    if size > LARGEST_FILE:
        limit = f"it must have at most {LARGEST_FILE} bytes, got {size}"
        raise ValueError(f"{path} is not a policy file: {limit}")
    with open(path, "rb") as file:
        if file.read(len(ZIP)) == ZIP:
            raise ValueError(
                f"{path} is no policy file, but an archive such as Stable-Baselines3's: "
                "Policy.from_sb3(PPO.load(..), env).save(..), with the agent's class and its "
                "environment, makes a policy file of it"
            )
    try:
        policy = _read(name, path)
    except (SafetensorError, ValueError, TypeError, RecursionError, OverflowError) as error:
        raise ValueError(f"{path} is not a policy file: {shortened(str(error))}") from error
    controller = policy.env_kwargs.get("controller")
    if not (trust_controller or is_own(controller)):
        raise ValueError(
            f"{path} names the control law {short_repr(controller)}, which does not come with this "
            "package; an environment made with it runs that code: "
            "load_policy(.., trust_controller=True) if you trust it"
        )
    return policy


def _find_file(given: str | os.PathLike[str]) -> Path:
    """The policy file with this path, or the best one in the run's folder with this path."""
    path = Path(given)
    # Unlike the methods of Path, these functions accept names that no file can have.
    if os.path.isdir(path):
        files = (path / "best" / POLICY, path / POLICY)
        path = next(filter(Path.is_file, files), path)
    if not os.path.isfile(path):
        name = str(given)
        hint = _law_named(name) or nearest(name, pretrained())
        raise ValueError(
            f"name_or_path must be one of {', '.join(policy_names())}, one run of it as "
            "NAME/seed-0, or the path of a policy file or of a run's folder, which holds "
            f"best/{POLICY} or {POLICY}, got {short_repr(name)}{hint}"
        )
    return path


def _check_array(
    name: str, array: np.ndarray, dtype: type, shape: tuple[int, ...], accepted: str
) -> None:
    """Raises an error for arrays of another dtype or shape, and for numbers that are not finite."""
    if array.dtype != dtype or array.shape != shape:
        wanted = f"{np.dtype(dtype).name} of shape {shape}, {accepted}"
        got = f"{array.dtype.name} of shape {array.shape}"
        raise ValueError(f"{name} must be {wanted}, got {got}")
    require(bool(np.isfinite(array).all()), name, "finite", array)


def _check_cell(cell: Cell, width: int) -> int:
    """Checks a cell that reads `width` values, and returns the number of its units."""
    shape = cell.weight_hh.shape
    units = shape[1] if len(shape) == 2 else 0
    accepted = f"of 1 to {MOST_CELL_UNITS} units"
    require(1 <= units <= MOST_CELL_UNITS, "cell.weight_hh", accepted, shape)
    sizes = [gates * units for gates in CELLS]
    size = shape[0] if shape[0] in sizes else sizes[0]
    accepted = "with 3 gates for a GRU or 4 for an LSTM"
    _check_array("cell.weight_hh", cell.weight_hh, np.float32, (size, units), accepted)
    _check_array("cell.weight_ih", cell.weight_ih, np.float32, (size, width), accepted)
    _check_array("cell.bias_ih", cell.bias_ih, np.float32, (size,), accepted)
    _check_array("cell.bias_hh", cell.bias_hh, np.float32, (size,), accepted)
    return units


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


def _layer_names(part: str, names: set[str]) -> list[tuple[str, str]]:
    """The names of the weights and biases of a part's layers, as many as there are weights."""
    count = sum(name.startswith(f"{part}.") and name.endswith(".weight") for name in names)
    count = min(count, MOST_LAYERS + 1)
    return [(f"{part}.{n}.weight", f"{part}.{n}.bias") for n in range(count)]


def _read(name: str, path: Path) -> Policy:
    """The policy in a file that is not too large."""
    with safe_open(path, framework="numpy") as file:
        metadata: dict[str, str] = file.metadata() or {}
        known = [(FORMAT, FORMAT_VERSION), (FORMAT, RECURRENT_VERSION)]
        found = (metadata.get("format"), metadata.get("format_version"))
        require(found in known, "its format and format_version", f"one of {known}", found)
        # Inputs and outputs that no policy has any more.
        former = {"output": "action", "told_energy_weight": "false", "identifies": "false"}
        for key, only in former.items():
            given = metadata.get(key, only)
            require(given == only, key, f"{only!r} in its metadata", given)
        names = set(file.keys())
        layers = _layer_names("layers", names)
        head = _layer_names("head", names)
        cell = [f"cell.{each}" for each in Cell._fields] if found == known[1] else []
        expected = {"inputs.mean", "inputs.variance"}.union(*layers, *head, cell)
        if names != expected:
            wanted = f"it must contain the tensors {sorted(expected)}"
            raise ValueError(f"{wanted}, got {short_repr(sorted(names))}")
        arrays = {tensor: file.get_tensor(tensor) for tensor in names}
    values: dict[str, Any] = {}
    for key in (*TEXTS, *VALUES):
        try:
            values[key] = metadata[key] if key in TEXTS else json.loads(metadata[key])
        except (KeyError, ValueError):
            accepted = f"{'text' if key in TEXTS else 'JSON'} in its metadata"
            got = f"{metadata.get(key)!r:.50}"
            raise ValueError(f"{key} must be {accepted}, got {got}") from None
    return Policy(
        name=name,
        layers=tuple((arrays[weights], arrays[bias]) for weights, bias in layers),
        cell=Cell(*(arrays[tensor] for tensor in cell)) if cell else None,
        head=tuple((arrays[weights], arrays[bias]) for weights, bias in head),
        mean=arrays["inputs.mean"],
        variance=arrays["inputs.variance"],
        **values,
    )
