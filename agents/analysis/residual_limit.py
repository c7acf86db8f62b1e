"""Sweep over the residual limit: agents of one budget on several laws, with more or less torque of their own."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import capsule_gym
from agents.analysis.data import Document
from agents.analysis.figures import write_with
from agents.evaluation.episodes import TABLE_METRICS, Episode, evaluate, versions
from agents.evaluation.sets import validation_set
from agents.evaluation.statistics import estimate, learning_curve, paired_difference
from agents.study.jobs import Job, evaluations, plan, revision_of, train_all
from agents.training.presets import ROWS, Config, RunError
from baselines.drawing import BLUE, GREEN, INK, MUTED, VERMILION, Pen, add_note, new_figure
from baselines.policies import SCRIPTED
from baselines.tables import markdown_table
from capsule_gym.evaluation_sets import EvaluationSet
from capsule_gym.files import write_atomically
from capsule_gym.task import TORQUE_LIMIT

RESULTS = Path(__file__).with_name("residual_limit.json")
SPEED = TABLE_METRICS["mean_speed"]
# N m; with twice the torque limit an agent can replace the law's torque by any other.
LIMITS = (0.75, 2.0 * TORQUE_LIMIT)
# By the scripted policy that is the law alone: its name, colour, and the ranges of plants that it is examined on.
BASES: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "adaptive": ("stiff", VERMILION, ("paper",)),
    "compliant": ("compliant", GREEN, ("paper",)),
    "gait-guarded": ("gait", BLUE, ("paper", "wide")),
}
# The row whose settings agents without a law have, by the plants.
DIRECT = {"paper": "direct-ppo", "wide": "direct-ppo-wide"}
# The row whose settings agents on a law have, but for law, limit, plants and budget, by the name in tables.
RECIPES = {"cautious": "residual-on-gait", "bold": "direct-ppo"}
STEPS, EVALUATIONS, SEEDS = 1_000_000, 5, (0, 1, 2)
# The plants of the evaluation: other seeds than those of training, of the selection and of the frozen sets.
FIRST_SEED, EPISODES = 3_000_000, 256
DASHES: dict[str, Any] = {"paper": "-", "wide": (0.0, (5.0, 1.6))}
MARKERS = {"paper": "o", "wide": "s"}


class Agent(NamedTuple):
    """One kind of agent.

    Attributes:
        base: the scripted policy whose law runs inside the step; "" for none.
        plants: the ranges of M and mu, in training and evaluation.
        limit: of the agent's torque, N m; 0.0 for the law alone.
        recipe: one of `RECIPES`; "" for a law alone, or without a law.
    """

    base: str
    plants: str
    limit: float
    recipe: str = ""

    @property
    def name(self) -> str:
        """Name of the folder of its runs."""
        return "-".join(filter(None, (self.base or "direct", self.plants, f"{self.limit:g}", self.recipe)))

    @property
    def cells(self) -> list[str]:
        """How tables name it: law, plants, and what its settings are."""
        label = BASES[self.base][0] if self.base else "none (direct)"
        return [label, self.plants, self.recipe or ("-" if self.base else DIRECT[self.plants])]

    @property
    def alone(self) -> Agent:
        """Its law without an agent."""
        return Agent(self.base, self.plants, 0.0)

    def config(self) -> Config:
        """What its runs are trained with, but for the seed."""
        shared: dict[str, Any] = {"total_steps": STEPS, "evaluate_every": STEPS // EVALUATIONS}
        if not self.recipe:
            return dataclasses.replace(ROWS[DIRECT[self.plants]], **shared)
        law = SCRIPTED[self.base].env_kwargs["controller"]
        shared |= {"controller": law, "residual_limit": self.limit, "randomization": self.plants}
        return dataclasses.replace(ROWS[RECIPES[self.recipe]], task="residual", **shared)


def agents() -> list[Agent]:
    """Every kind of agent that is trained, base by base."""
    on_laws = [
        Agent(base, each, limit, recipe)
        for base, (_, _, plants) in BASES.items()
        for each in plants
        for recipe in RECIPES
        for limit in LIMITS
    ]
    return [*on_laws, *(Agent("", plants, TORQUE_LIMIT) for plants in DIRECT)]


def evaluation_plants(plants: str) -> EvaluationSet:
    """The episodes that all agents are evaluated on."""
    # The name is a part of the hash in the results.
    return validation_set(plants, f"authority, {plants}", FIRST_SEED, EPISODES)


class Results:
    """The runs of a sweep.

    Attributes:
        content: steps of a run, hashes of the sets, versions, and the runs. A run has its `arm` (the kind of agent),
            the training `seed`, the `speeds` of its episodes (cm/s), the numbers of those that `failed`, `learning`
            (steps, mean speed in cm/s and share of failures of its evaluations during training) and the `revision`.
    """

    def __init__(self, content: dict[str, Any]) -> None:
        self.content = content
        self.runs: dict[Agent, list[dict[str, Any]]] = {}
        for run in sorted(content["runs"], key=lambda run: run["seed"] or 0):
            self.runs.setdefault(Agent(**run["arm"]), []).append(run)

    def speeds(self, agent: Agent) -> np.ndarray:
        """Speeds of an agent's runs, shape (runs, episodes), cm/s."""
        return np.array([run["speeds"] for run in self.runs[agent]])

    def failed(self, agent: Agent) -> np.ndarray:
        """Whether these episodes failed, the same shape, as 0.0 and 1.0."""
        found = np.zeros(self.speeds(agent).shape)
        for line, run in zip(found, self.runs[agent], strict=True):
            line[run["failed"]] = 1.0
        return found


def load(path: Path = RESULTS) -> Results:
    """Reads the results.

    Raises:
        ValueError: if they were made on other plants.
    """
    content = json.loads(path.read_text(encoding="utf-8"))
    for name, value in content["sets"].items():
        if evaluation_plants(name).hash != value:
            raise ValueError(f"{path} holds episodes on other plants of {name} than there are now: train again")
    return Results(content)


def document(policies: Sequence[str] = ()) -> Document:
    """The tables and the figure of the committed results; there is no choice of policies."""
    results = load()
    sections = {
        "design": describe(results),
        "residual_limit": speed_table(results),
        "learning": learning_table(results),
    }
    return Document(sections, {"figures/residual_limit": write_with(draw, results)})


def describe(results: Results) -> str:
    """What was trained, in a sentence."""
    seeds = [run["seed"] for run in results.content["runs"] if run["seed"] is not None]
    listed = ", ".join(map(str, sorted(set(seeds))))
    trained = f"{len(seeds)} trainings of {results.content['steps']:,} steps, training seeds {listed}"
    return f"{trained}; {len(results.content['runs'][0]['speeds'])} plants of each kind."


def speed_table(results: Results) -> str:
    """Every agent compared with its law alone; the stiff law first, no law last."""
    table = [["law", "plants", "agent's limit (N m)", "learns", SPEED.label, "failed", "minus the law alone"]]
    for agent in sorted(results.runs, key=lambda agent: (not agent.base, *agent[:3])):
        speeds, failed = results.speeds(agent), results.failed(agent)
        change = "-"
        if agent.base and agent != agent.alone:
            alone = results.speeds(agent.alone)
            change = SPEED.with_interval(paired_difference(speeds, alone).to_dict(), sign=True)
        speed = SPEED.with_interval(estimate(speeds).to_dict())
        law, plants, learns = agent.cells
        table.append([law, plants, f"{agent.limit:g}", learns, speed, f"{failed.sum():.0f}/{failed.size}", change])
    return markdown_table(table)


def learning_table(results: Results) -> str:
    """Mean speed during training, of agents on the gait with the small limit and of agents without a law."""
    steps = [round(share * results.content["steps"]) for share in (0.05, 0.1, 0.25, 0.5, 1.0)]
    table = [["law", "plants", "learns", *(f"{each / 1e6:g} M steps" for each in steps)]]
    for plants in DIRECT:
        on_gait = [Agent("gait-guarded", plants, LIMITS[0], recipe) for recipe in RECIPES]
        for agent in (*on_gait, Agent("", plants, TORQUE_LIMIT)):
            found = [np.array(run["learning"]) for run in results.runs.get(agent, [])]
            if found:
                curve = learning_curve([(each[:, 0], each[:, 1]) for each in found])
                # An evaluation comes with the first update after it is due.
                shown = np.searchsorted(curve.x, steps).clip(max=len(curve.x) - 1)
                table.append([*agent.cells, *(SPEED.format(curve.value[n]) for n in shown)])
    return markdown_table(table)


def draw(results: Results) -> Any:
    """Speed and failures over the residual limit, a column per recipe."""
    figure = new_figure(5.0)
    grid = figure.subplots(2, len(RECIPES), sharex=True, sharey="row", height_ratios=(1.6, 1.0), squeeze=False)
    places = {limit: place for place, limit in enumerate((0.0, *LIMITS))}
    lines = [(base, plants) for base, (_, _, examined) in BASES.items() for plants in examined]
    for (speed, failed), recipe in zip(grid.T, RECIPES, strict=True):
        for n, (base, plants) in enumerate(lines):
            shown = [Agent(base, plants, 0.0), *(Agent(base, plants, limit, recipe) for limit in LIMITS)]
            shown = [agent for agent in shown if agent in results.runs]
            # Lines that would lie on each other are a little apart.
            x = [places[agent.limit] + 0.06 * (n - 0.5 * (len(lines) - 1)) for agent in shown]
            name, colour, _ = BASES[base]
            line = Pen(colour, DASHES[plants]).line(marker=MARKERS[plants], markersize=3.5)
            found = [estimate(results.speeds(agent)) for agent in shown]
            shares = [100.0 * results.failed(agent).mean(axis=1) for agent in shown]
            speed.plot(x, [each.value for each in found], label=f"{name} law, {plants}", **line)
            failed.plot(x, [share.mean() for share in shares], **line)
            for place, each, share in zip(x, found, shares, strict=True):
                # For a law alone plants are resampled, which is no interval over training seeds.
                if each.resampled == "seeds":
                    speed.plot([place] * 2, [each.low, each.high], color=colour, linewidth=1.0)
                    failed.plot([place] * 2, [share.min(), share.max()], color=colour, linewidth=1.0)
        for plants in DIRECT:
            agent, line = Agent("", plants, TORQUE_LIMIT), Pen(MUTED, DASHES[plants]).line(linewidth=1.0)
            if agent in results.runs:
                speed.axhline(estimate(results.speeds(agent)).value, label=f"no law, {plants}", **line)
                failed.axhline(100.0 * results.failed(agent).mean(), **line)
        speed.set(title=f"Learning {recipe}ly", ylim=(0.0, None))
        # Without failures the axis would have ticks of thousandths.
        failed.set_ylim(0.0, max(5.0, failed.get_ylim()[1]))
        failed.set_xticks(list(places.values()), [f"{limit:g}" for limit in places])
        failed.set_xlabel("limit of the agent's torque (N m)", color=INK)
    grid[0][0].set_ylabel("mean speed (cm/s)")
    grid[1][0].set_ylabel("failed (%)")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    add_note(
        figure,
        "At 0 the law alone; at 3 N m an agent can replace its torque by any other. "
        f"{results.content['steps'] / 1e6:g} M steps each; bars: 95 % over training seeds (with few of them their "
        "range), for failures the range.",
    )
    return figure


def evaluated(agent: Agent, episodes: Sequence[Episode], job: Job | None = None) -> dict[str, Any]:
    """A run as the results hold it; a law alone has no job."""
    learning = (
        [[line["steps"], line["mean_speed_cm_s"], line["failed"]] for line in evaluations(job.run)] if job else []
    )
    return {
        "arm": agent._asdict(),
        "seed": job.config.seed if job else None,
        "speeds": [round(each["mean_speed"], 4) for each in episodes],
        "failed": [n for n, each in enumerate(episodes) if each["failed"]],
        "learning": learning,
        "revision": revision_of(job.run) if job else None,
    }


def train(runs: Path = Path("runs/residual_limit")) -> None:
    """Trains the agents, or resumes their runs, evaluates them and writes the results.

    Args:
        runs: the folder of the runs.

    Raises:
        RunError: if a run fails.
    """
    kinds = {agent.name: agent for agent in agents()}
    jobs = plan({name: agent.config() for name, agent in kinds.items()}, SEEDS, runs)
    for job, reason in train_all(jobs).items():
        raise RunError(f"{job.name} failed: {reason}")
    sets = {plants: evaluation_plants(plants) for plants in DIRECT}
    laws = dict.fromkeys(agent.alone for agent in kinds.values() if agent.base)
    results = [evaluated(law, evaluate(SCRIPTED[law.base], sets[law.plants])) for law in laws]
    for job in jobs:
        agent = kinds[job.row]
        results.append(evaluated(agent, evaluate(capsule_gym.load_policy(job.run), sets[agent.plants]), job))
    content = {"steps": STEPS, "sets": {name: each.hash for name, each in sets.items()}, "versions": versions()}
    # A line per run.
    lines = ",\n".join(json.dumps(run, separators=(",", ":")) for run in results)
    write_atomically(RESULTS, f'{json.dumps(content)[:-1]}, "runs": [\n{lines}\n]}}\n')
