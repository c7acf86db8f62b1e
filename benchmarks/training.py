"""What training costs and what it learns, with one setting changed at a time.

    python -m benchmarks.training              # trains several settings and compares what they have learned
    python -m benchmarks.training --sweep      # steps per second, updates included
    python -m benchmarks.training --profile    # where the time of a training goes

Absolute numbers do not carry from machine to machine; the ratios do. In --sweep and --profile the contenders take
turns, so that whatever else the machine does meets them all, and the medians of the turns count. Ctrl-C ends each of
the three early and keeps what there is; a comparison goes on where it stopped when it is called again.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
import os
import platform
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import stable_baselines3.sac.sac as sb3_sac
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecNormalize
from tqdm import tqdm

import agents.sac
import capsule_gym
from agents.candidates import find_candidate
from agents.evaluation import Episode, difference, evaluate, summarise, versions
from agents.presets import PPOConfig, SACConfig
from agents.reporting import MEASURES, markdown_table, text_table
from agents.runs import MODEL, load_policy
from agents.sets import EvaluationSet, load_set
from agents.training import begin, make_env, make_model, train
from baselines.files import to_json, write_atomically
from benchmarks.timing import available_cores

RUNS = Path("runs/benchmark-training")
COST = "cost.json"
SPEED = MEASURES["mean_speed"]

# What Stable-Baselines3 does where nothing is said, on eight environments.
UNTUNED: dict[str, Any] = {
    "num_envs": 8,
    "n_steps": 2048,
    "batch_size": 64,
    "n_epochs": 10,
    "learning_rate": 3e-4,
    "final_learning_rate": 3e-4,
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "ent_coef": 0.0,
    "log_std_init": 0.0,
}
# As many steps in an update as the preset, from four times the environments.
BROAD: dict[str, Any] = {"num_envs": 256, "n_steps": 64, "batch_size": 4096}
SETTINGS: dict[str, dict[str, Any]] = {"tuned": {}, "untuned": UNTUNED, "broad": BROAD}
# Points of the learning curve that the table shows, as parts of the whole.
CURVE = (0.25, 0.5, 0.75, 1.0)


# --- what is learned -------------------------------------------------------------------------------------------------


def train_run(run: Path, config: PPOConfig) -> bool:
    """Trains a run, or goes on with it; adds up its processor time. Returns whether it came to its end."""
    if (run / MODEL).is_file() and (run / COST).is_file():
        if json.loads((run / COST).read_text(encoding="utf-8"))["done"]:
            return True
    spent = 0.0
    if (run / COST).is_file():
        spent = json.loads((run / COST).read_text(encoding="utf-8"))["processor_seconds"]
    if not run.exists():
        begin(run, config)
    start = time.process_time()
    done = train(run, config)
    write_atomically(run / COST, to_json({"processor_seconds": spent + time.process_time() - start, "done": done}))
    return done


def curve(run: Path) -> list[tuple[int, float]]:
    """Steps and mean speed on the run's own draws at each evaluation while training."""
    with (run / "evaluations.csv").open(encoding="utf-8") as file:
        return [(int(row["steps"]), float(row["mean_speed_cm_s"])) for row in csv.DictReader(file)]


def record(run: Path, seed: int, evaluation_set: EvaluationSet) -> tuple[dict[str, Any], list[Episode]]:
    """What a finished run has cost and learned, and its episodes."""
    points = curve(run)
    seconds = json.loads((run / COST).read_text(encoding="utf-8"))["processor_seconds"]
    episodes = [{**episode, "training_seed": seed} for episode in evaluate(load_policy(run), evaluation_set)]
    content = {
        "seed": seed,
        "steps": points[-1][0],
        "processor_seconds": seconds,
        "steps_per_second": points[-1][0] / seconds,
        "curve": points,
    }
    return content, episodes


def compare(
    names: Sequence[str], seeds: Sequence[int], steps: int, runs: Path, evaluation_set: EvaluationSet
) -> dict[str, Any]:
    """Trains settings with several seeds each and evaluates them on a set.

    Args:
        names: of `SETTINGS`, or of committed checkpoints, which are evaluated only. Differences are to the first.
        seeds: training seeds of each setting.
        steps: environment steps of each run.
        runs: folder of the runs; those that it holds already are gone on with.
        evaluation_set: what counts at the end.

    Returns:
        Per name the summary, the paired difference of the mean speed to the first, and the runs with their cost.
    """
    episodes: dict[str, list[Episode]] = {}
    records: dict[str, list[dict[str, Any]]] = {}
    try:
        for name in names:
            if name not in SETTINGS:
                records[name], episodes[name] = [], find_candidate(name).evaluate(evaluation_set)
        # Seed by seed, so that a comparison that is cut short has something of each setting.
        for seed in seeds:
            for name in (name for name in names if name in SETTINGS):
                config = dataclasses.replace(PPOConfig(), seed=seed, total_steps=steps, **SETTINGS[name])
                run = runs / f"{name}-{steps}-seed{seed}"
                print(f"{name}, seed {seed}, in {run}", file=sys.stderr)
                if not train_run(run, config):
                    raise KeyboardInterrupt
                content, played = record(run, seed, evaluation_set)
                records.setdefault(name, []).append(content)
                episodes.setdefault(name, []).extend(played)
    except KeyboardInterrupt:
        print("\nStopped; the same command goes on from here. What is finished:", file=sys.stderr)
    found = [name for name in names if name in episodes]
    return {
        name: {
            "changes": SETTINGS.get(name),
            "summary": summarise(episodes[name]),
            "difference": difference(episodes[name], episodes[found[0]], "mean_speed").to_dict(),
            "runs": records[name],
        }
        for name in found
    }


def comparison_rows(results: dict[str, Any], steps: int) -> list[list[str]]:
    """The comparison as a table; the curve's points are means over the seeds."""
    head = ["setting", "seeds", "mean speed (cm/s) [95 %]", "difference", "failures"]
    rows = [[*head, *(f"at {part * steps / 1e6:g} M" for part in CURVE), "steps/s", "minutes"]]
    for n, (name, result) in enumerate(results.items()):
        summary, runs = result["summary"], result["runs"]
        cells = []
        for part in CURVE:
            speeds = [min(run["curve"], key=lambda point: abs(point[0] - part * steps))[1] for run in runs]
            cells.append(f"{statistics.mean(speeds):.2f}" if speeds else "")
        cost = ["", ""]
        if runs:
            cost = [
                f"{statistics.median(run['steps_per_second'] for run in runs):,.0f}",
                f"{statistics.median(run['processor_seconds'] for run in runs) / 60:.1f}",
            ]
        rows.append(
            [
                name,
                str(len(summary["training_seeds"])),
                SPEED.with_interval(summary["mean_speed"]),
                SPEED.with_interval(result["difference"], sign=True) if n else "",
                f"{summary['failures']}/{summary['episodes']}",
                *cells,
                *cost,
            ]
        )
    return rows


# --- what it costs ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Contender:
    """Something that trains.

    Attributes:
        name: for the table.
        make: makes the agent with its environments.
        threads: of torch.
        updates: gradient steps per environment step.
    """

    name: str
    make: Callable[[], BaseAlgorithm]
    threads: int = 1
    updates: float = 0.0


def ppo(name: str, vec_env: Callable[[PPOConfig], VecEnv] | None = None, **changes: Any) -> Contender:
    """The PPO preset of the residual task with some fields changed."""
    config = dataclasses.replace(PPOConfig(), **changes)

    def make() -> BaseAlgorithm:
        if vec_env is None:
            return make_model(config, make_env(config, 0))
        return make_model(config, VecNormalize(vec_env(config), norm_reward=False, gamma=config.gamma))

    return Contender(name, make, config.torch_threads, config.n_epochs / config.batch_size)


def sac(name: str, kind: type[SAC] = agents.sac.LeanSAC, fused: bool = True, **changes: Any) -> Contender:
    """The SAC preset of the residual task with some fields changed, or another class; updates begin at once."""
    config = dataclasses.replace(SACConfig(), **{"learning_starts": 1000, **changes})

    def make() -> BaseAlgorithm:
        return make_model(config, make_env(config, 0), sac=kind, fused=fused)

    return Contender(name, make, config.torch_threads, config.gradient_steps / config.num_envs)


def one_by_one(kind: type[DummyVecEnv] | type[SubprocVecEnv]) -> Callable[[PPOConfig], VecEnv]:
    """Environments of gym.make, as most tutorials have them."""

    def make(config: PPOConfig) -> VecEnv:
        return kind([lambda: gym.make(capsule_gym.ENV_ID, **config.env_kwargs()) for _ in range(config.num_envs)])

    return make


ROLLOUT = 16_384


def axes() -> dict[str, list[Contender]]:
    """What --sweep measures; the first of each axis is what the ratios are to."""
    threads = ((1, 1), (1, 2), (2, 1), (2, 2))
    # Shorter rollouts cost the same per step, and let a turn end sooner.
    quick = {**UNTUNED, "n_steps": 512}
    return {
        "environments": [
            ppo("64 (preset)"),
            *(ppo(str(count), num_envs=count, n_steps=ROLLOUT // count) for count in (16, 256, 1024)),
        ],
        "minibatch": [
            ppo("2048 (preset)"),
            *(ppo(str(size), batch_size=size) for size in (64, 256, 1024, 4096, 8192)),
        ],
        "threads": [
            ppo(
                f"environment {env}, torch {own}" + (" (preset)" if env == own == 1 else ""),
                env_threads=env,
                torch_threads=own,
            )
            for env, own in threads
        ],
        "broad-threads": [
            ppo(f"environment {env}, torch {own}", env_threads=env, torch_threads=own, **BROAD) for env, own in threads
        ],
        "vec-env": [
            ppo("preset"),
            ppo("broad", **BROAD),
            ppo("untuned, native batch of 8", **quick),
            ppo("untuned, DummyVecEnv of 8", one_by_one(DummyVecEnv), **quick),
            ppo("untuned, SubprocVecEnv of 8", one_by_one(SubprocVecEnv), **quick),
        ],
        "sac": [
            sac("SB3's SAC", SAC, fused=False),
            sac("SB3's SAC, fused Adam", SAC),
            sac("LeanSAC", fused=False),
            sac("LeanSAC, fused Adam (preset)"),
            sac("preset, torch 2", torch_threads=2),
            sac("preset, batch 2048, 2 updates", batch_size=2048, gradient_steps=2),
            sac("preset, 64 environments, 16 updates", num_envs=64, gradient_steps=16),
        ],
    }


def vector_step(model: BaseAlgorithm) -> int:
    """The fewest environment steps that the agent learns from at once."""
    return model.n_envs * (model.n_steps if isinstance(model, OnPolicyAlgorithm) else 1)


def learn(model: BaseAlgorithm, count: int) -> float:
    """Goes on training for `count` of its own units; returns the seconds."""
    start = time.perf_counter()
    model.learn(count * vector_step(model), reset_num_timesteps=False)
    return time.perf_counter() - start


def prepare(rival: Contender, seconds: float) -> tuple[BaseAlgorithm, int]:
    """The agent past its first update, and how many of its units fill a turn of that many seconds."""
    torch.set_num_threads(rival.threads)
    model = rival.make()
    if not isinstance(model, OnPolicyAlgorithm):
        learn(model, 40)
    trial = 1 if isinstance(model, OnPolicyAlgorithm) else 20
    return model, max(1, round(seconds * trial / learn(model, trial)))


@contextmanager
def torch_threads_kept() -> Iterator[None]:
    """Gives torch its number of threads back at the end."""
    before = torch.get_num_threads()
    try:
        yield
    finally:
        torch.set_num_threads(before)


def take_turns(
    rivals: Sequence[Contender],
    turns: int,
    seconds: float,
    title: str,
    turn: Callable[[Contender, BaseAlgorithm, int], str],
) -> None:
    """Lets contenders train in turns. Ctrl-C ends it; what was measured until then counts.

    Args:
        rivals: what takes turns.
        turns: how many turns each takes.
        seconds: about how long a turn is.
        title: for the progress bar.
        turn: takes the contender, its agent and the number of its units to train; returns what the bar shows.
    """
    models: list[BaseAlgorithm] = []
    with torch_threads_kept(), tqdm(total=turns * len(rivals), desc=title, unit=" turns", dynamic_ncols=True) as bar:
        try:
            counts = []
            for rival in rivals:
                model, count = prepare(rival, seconds)
                models.append(model)
                counts.append(count)
            for _ in range(turns):
                for rival, model, count in zip(rivals, models, counts, strict=True):
                    torch.set_num_threads(rival.threads)
                    bar.set_postfix_str(turn(rival, model, count), refresh=False)
                    bar.update()
        except KeyboardInterrupt:
            print("\nStopped; what was measured:", file=sys.stderr)
        finally:
            for model in models:
                cast(VecEnv, model.get_env()).close()


def sweep(rivals: Sequence[Contender], turns: int, seconds: float, title: str = "") -> dict[str, list[float]]:
    """Environment steps per second of each, updates included, one number per turn; arguments as for `take_turns`."""
    rates: dict[str, list[float]] = defaultdict(list)

    def turn(rival: Contender, model: BaseAlgorithm, count: int) -> str:
        rates[rival.name].append(count * vector_step(model) / learn(model, count))
        return f"{rival.name}: {rates[rival.name][-1]:,.0f} steps/s"

    take_turns(rivals, turns, seconds, title, turn)
    return dict(rates)


def sweep_rows(rivals: Sequence[Contender], rates: dict[str, list[float]]) -> list[list[str]]:
    """The sweep of one axis as a table; ratios are medians over the turns, each to the first contender's turn."""
    rows = [["", "env steps/s", "gradient updates/s", "ratio", "range of the ratio"]]
    first = rates[rivals[0].name]
    for rival in rivals:
        if rival.name not in rates:
            continue
        rate = statistics.median(rates[rival.name])
        ratios = [own / other for own, other in zip(rates[rival.name], first, strict=False)]
        rows.append(
            [
                rival.name,
                f"{rate:,.0f}",
                f"{rate * rival.updates:,.0f}",
                f"{statistics.median(ratios):.2f}",
                f"{min(ratios):.2f} to {max(ratios):.2f}" if rival is not rivals[0] else "",
            ]
        )
    return rows


# --- where it goes ---------------------------------------------------------------------------------------------------


class Clocks:
    """Adds up the time inside functions, without what other clocked functions inside them take."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._inner: list[float] = []
        self._undo: list[Callable[[], None]] = []

    def watch(self, owner: Any, name: str, label: str) -> None:
        """Puts a clock on a function of a module, class or object."""
        function = getattr(owner, name)
        own = name in vars(owner)

        def clocked(*args: Any, **kwargs: Any) -> Any:
            self._inner.append(0.0)
            start = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                whole = time.perf_counter() - start
                self.seconds[label] += whole - self._inner.pop()
                if self._inner:
                    self._inner[-1] += whole

        setattr(owner, name, clocked)
        self._undo.append(lambda: setattr(owner, name, function) if own else delattr(owner, name))

    def stop(self) -> None:
        """Takes all clocks off."""
        while self._undo:
            self._undo.pop()()


COLLECT, ENVIRONMENT, NORMALISE = "collect: policy and bookkeeping", "collect: environment", "collect: normalisation"
FORWARD, BACKWARD, ADAM, REST = "update: networks", "update: backward", "update: Adam", "update: losses and the rest"
STORE, SAMPLE, TARGETS = "collect: store in replay buffer", "update: draw from replay buffer", "update: target networks"


def watch(model: BaseAlgorithm, clocks: Clocks) -> None:
    """Puts clocks on the parts of a training."""
    env = cast(VecNormalize, model.get_vec_normalize_env())
    clocks.watch(model, "collect_rollouts", COLLECT)
    clocks.watch(env, "step_wait", NORMALISE)
    clocks.watch(env.venv, "step_wait", ENVIRONMENT)
    clocks.watch(model, "train", REST)
    clocks.watch(torch.Tensor, "backward", BACKWARD)
    clocks.watch(torch.autograd, "grad", BACKWARD)
    if isinstance(model, PPO):
        optimizers: list[torch.optim.Optimizer] = [model.policy.optimizer]
        clocks.watch(model.policy, "evaluate_actions", FORWARD)
    else:
        assert isinstance(model, SAC) and model.ent_coef_optimizer is not None and model.replay_buffer is not None
        optimizers = [model.actor.optimizer, model.critic.optimizer, model.ent_coef_optimizer]
        clocks.watch(model.replay_buffer, "add", STORE)
        clocks.watch(model.replay_buffer, "sample", SAMPLE)
        for network in (*model.critic.q_networks, *model.critic_target.q_networks, model.actor.latent_pi):
            clocks.watch(network, "forward", FORWARD)
        clocks.watch(model.actor.mu, "forward", FORWARD)
        clocks.watch(model.actor.log_std, "forward", FORWARD)
        clocks.watch(sb3_sac, "polyak_update", TARGETS)
        clocks.watch(torch, "_foreach_lerp_", TARGETS)
    for optimizer in optimizers:
        clocks.watch(optimizer, "step", ADAM)
        clocks.watch(optimizer, "zero_grad", ADAM)


def profile(rivals: Sequence[Contender], turns: int, seconds: float) -> dict[str, dict[str, float]]:
    """Microseconds per environment step that each part of a training takes."""
    totals: dict[str, Clocks] = defaultdict(Clocks)
    steps: dict[str, int] = defaultdict(int)

    def turn(rival: Contender, model: BaseAlgorithm, count: int) -> str:
        clocks = totals[rival.name]
        watch(model, clocks)
        try:
            learn(model, count)
        finally:
            clocks.stop()
        steps[rival.name] += count * vector_step(model)
        return rival.name

    take_turns(rivals, turns, seconds, "profile", turn)
    return {
        name: {part: 1e6 * value / steps[name] for part, value in clocks.seconds.items()}
        for name, clocks in totals.items()
        if steps[name]
    }


def profile_rows(results: dict[str, dict[str, float]]) -> list[list[str]]:
    """The profile as a table."""
    order = (ENVIRONMENT, NORMALISE, COLLECT, STORE, SAMPLE, FORWARD, BACKWARD, ADAM, TARGETS, REST)
    sums = {name: sum(parts.values()) for name, parts in results.items()}
    rows = [["us per environment step", *results]]
    for part in order:
        if any(part in parts for parts in results.values()):
            cells = [
                f"{parts[part]:.1f} ({100.0 * parts[part] / sums[name]:.0f} %)" if part in parts else ""
                for name, parts in results.items()
            ]
            rows.append([part, *cells])
    return [*rows, ["sum", *(f"{value:.1f}" for value in sums.values())]]


def profiled() -> list[Contender]:
    """What --profile measures."""
    return [
        ppo("PPO, preset"),
        ppo("PPO, broad", **BROAD),
        sac("SB3's SAC", SAC, fused=False),
        sac("LeanSAC, fused Adam (preset)"),
    ]


# --- the command line ------------------------------------------------------------------------------------------------


def machine() -> str:
    """The machine, in words."""
    return f"{available_cores()} of {os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"


def number(text: str) -> int:
    """A positive integer, also in the form 6e6."""
    value = float(text)
    if value != int(value) or value < 1:
        raise argparse.ArgumentTypeError(f"must be an integer >= 1, got {text!r}")
    return int(value)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.training",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    kinds = parser.add_mutually_exclusive_group()
    known = axes()
    kinds.add_argument(
        "--sweep",
        nargs="*",
        metavar="AXIS",
        choices=list(known),
        help=f"measure steps per second along these axes (default: all): {', '.join(known)}",
    )
    kinds.add_argument("--profile", action="store_true", help="measure what the time of a training goes to")
    parser.add_argument(
        "--settings",
        nargs="+",
        default=["tuned", "untuned"],
        metavar="NAME",
        help=f"what is compared: {', '.join(SETTINGS)}, or a committed checkpoint, which is only evaluated; "
        "differences are to the first (default: tuned untuned)",
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N", help="default: 0 1 2")
    parser.add_argument("--steps", type=number, default=6_000_000, metavar="N", help="of each run (default: 6e6)")
    parser.add_argument("--set", default="paper", metavar="SET", help="evaluation set (default: paper)")
    parser.add_argument("--runs", type=Path, default=RUNS, metavar="DIR", help=f"folder of the runs (default: {RUNS})")
    parser.add_argument("--turns", type=number, default=5, metavar="N", help="of every contender (default: 5)")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="of a turn, about (default: 2)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to this new file")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables to this file")
    options = parser.parse_args(arguments)
    if options.json is not None and options.json.exists():
        parser.error(f"--json must name a new file, got {str(options.json)!r}")
    if options.sweep is not None:
        rates: dict[str, dict[str, list[float]]] = {}
        tables: dict[str, list[list[str]]] = {}
        content: dict[str, Any] = {"env_steps_per_second": rates, "turns": options.turns, "seconds": options.seconds}
        note = f"{options.turns} turns of about {options.seconds:g} s"
        for axis in options.sweep or known:
            measured = sweep(known[axis], options.turns, options.seconds, axis)
            if known[axis][0].name not in measured:
                break
            rates[axis], tables[axis] = measured, sweep_rows(known[axis], measured)
            print(f"\n{axis}\n\n{text_table(tables[axis])}", flush=True)
            # After every axis, so that nothing is lost.
            write(options, content, tables, note)
        return 0
    if options.profile:
        parts = profile(profiled(), options.turns, options.seconds)
        content = {"microseconds_per_env_step": parts, "turns": options.turns, "seconds": options.seconds}
        rows = profile_rows(parts)
        note = f"{options.turns} turns of about {options.seconds:g} s"
    else:
        try:
            evaluation_set = load_set(options.set)
            for name in options.settings:
                if name not in SETTINGS:
                    find_candidate(name)
        except ValueError as error:
            parser.error(str(error))
        results = compare(options.settings, options.seeds, options.steps, options.runs, evaluation_set)
        content = {
            "steps": options.steps,
            "set": evaluation_set.name,
            "set_hash": evaluation_set.hash,
            "settings": results,
        }
        rows = comparison_rows(results, options.steps)
        note = f"steps/s and minutes of processor time, evaluations included; the set is {evaluation_set.name}"
    print(f"\n{text_table(rows)}")
    write(options, content, {"profile" if options.profile else "learning": rows}, note)
    return 0


def write(options: argparse.Namespace, content: dict[str, Any], tables: dict[str, list[list[str]]], note: str) -> None:
    """Writes the numbers and the tables where the command line wants them."""
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(options.json, to_json({"machine": machine(), "versions": versions(), **content}))
    if options.markdown is not None:
        lines = ["<!-- Written by python -m benchmarks.training: do not edit. -->", ""]
        for name, rows in tables.items():
            lines += [f"<!-- --8<-- [start:{name}] -->", *markdown_table(rows)]
            lines += ["", f"{machine()}; {note}.", f"<!-- --8<-- [end:{name}] -->", ""]
        write_atomically(options.markdown, "\n".join(lines))


if __name__ == "__main__":
    sys.exit(main())
