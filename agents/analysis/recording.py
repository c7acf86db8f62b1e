"""Recordings of episodes: time series, a figure that compares recordings, and the documentation's animations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.analysis.data import Document
from agents.evaluation.policies import Policy, find_candidate
from baselines.drawing import BLUE, DPI, GREEN, INK, MUTED, VERMILION, new_figure, style
from capsule_gym.config import DIRECT_PHYSICS_DT, EnvConfig
from capsule_gym.env import shown_state
from capsule_gym.evaluation_sets import EPISODE_SETTINGS, NOMINAL_PLANT, PlantSpec
from capsule_gym.files import replacing
from capsule_gym.layout import Row
from capsule_gym.rendering import FRAME_SECONDS, Renderer, write_gif
from capsule_gym.settings import divide
from capsule_gym.simulation import Simulation
from capsule_gym.task import CONTROL_DT, HORIZON

# Length of the shown part of torque, angle and contact at the end of an episode, s.
LAST = 6.6
# Policies of the speed task with an animation.
POLICIES = ("adaptive", "residual-on-gait")
# Policies of the other tasks with an animation: the plant, and the start and length of the part shown, s.
TASK_POLICIES = {
    "goal-pulses": (PlantSpec(0.5, 0.16, seed=0, goal=0.3), 0.0, 4.6),
    "velocity-pulses": (PlantSpec(0.5, 0.16, seed=21), 2.5, 7.0),
}
# Start and length of the part shown and time between frames, s; the paper's controller slips once in this part.
BEGIN, SECONDS, ANIMATION_FRAME_SECONDS = 12.0, 3.4, 0.08


@dataclass(frozen=True, eq=False)
class Recording:
    """One episode with a sample per period of the torque; the first sample is the start.

    Attributes:
        name: name of the policy.
        t: s, shape (n,).
        theta: rad.
        theta_dot: rad/s.
        x: m.
        x_dot: m/s; exactly 0.0 in stick.
        torque: the motor's torque in the period that ends at t, N m.
        normal_force: the smallest normal force in that period, N.
        torque_limit: N m.
        failed: whether the episode was terminated.
        frames: frames, each (height, width, 3) uint8; empty if none were requested.
    """

    name: str
    t: np.ndarray
    theta: np.ndarray
    theta_dot: np.ndarray
    x: np.ndarray
    x_dot: np.ndarray
    torque: np.ndarray
    normal_force: np.ndarray
    torque_limit: float
    failed: bool
    frames: tuple[np.ndarray, ...] = ()

    def cut(self, first: int, last: int) -> Recording:
        """The samples from `first` to `last`, both included, with time and position relative to the first sample."""
        series = {name: getattr(self, name)[first : last + 1] for name in SERIES}
        return replace(self, **{**series, "t": series["t"] - self.t[first], "x": series["x"] - self.x[first]})


SERIES = [each.name for each in fields(Recording) if each.type == "np.ndarray"]


def record(
    policy: Policy,
    plant: PlantSpec = NOMINAL_PLANT,
    *,
    seconds: float = HORIZON,
    frames_from: float | None = None,
    frame_seconds: float = FRAME_SECONDS,
    name: str | None = None,
) -> Recording:
    """Runs a policy on one plant and records every period of the torque; the motion is that of an evaluation.

    Args:
        policy: the policy; acts at the control interval of its environment.
        plant: a plant with constant parameters.
        seconds: length of the recording.
        frames_from: time of the first frame, s; None draws no frames.
        frame_seconds: time between frames.
        name: name of the recording; None takes the policy's name.
    """
    name = name or policy.name
    names = {each.name for each in fields(EnvConfig)}
    settings = {key: value for key, value in {**policy.env_kwargs, **EPISODE_SETTINGS}.items() if key in names}
    controller = Simulation(1, EnvConfig(**settings)).controller
    # The torque is constant for a period of the law or, without a law, for many steps of the integrator.
    dt = controller.dt if controller else settings.get("physics_dt") or DIRECT_PHYSICS_DT
    periods = divide("control_dt", settings.get("control_dt", CONTROL_DT), "a period of the torque", dt)
    simulation = Simulation(1, EnvConfig(**{**settings, "control_dt": dt}))
    limit = simulation.settings.torque_limit
    steps, first_frame, frame_every = round(seconds / dt), round(seconds / dt) + 1, round(frame_seconds / dt)
    if frames_from is not None:
        first_frame = round(frames_from / dt)
        renderer = Renderer(simulation.capsule, "rgb_array", 50, limit, name)
    simulation.seed(0, plant.seed)
    start: dict[str, Any] = {name: [value] for name, value in plant.reset_options().items()}
    simulation.reset(np.zeros(1, np.int64), **start)
    act = policy.start([plant.seed])
    wanted = [getattr(Row, each) for each in SERIES[1:]]
    samples, frames, action, failed = [], [], np.zeros(1), False
    for n in range(steps + 1):
        samples.append([simulation.row(row)[0] for row in wanted])
        if n >= first_frame and (n - first_frame) % frame_every == 0:
            frames.append(np.asarray(renderer.draw(**shown_state(simulation, 0))))
        if failed or n == steps:
            break
        if n % periods == 0:
            action = act(simulation.observations.copy())[:, 0].astype(np.float64)
        simulation.step(action)
        failed = bool(simulation.row(Row.termination)[0] != 0.0)
    series = dict(zip(SERIES[1:], np.array(samples).T, strict=True))
    return Recording(
        name, np.arange(len(samples)) * dt, **series, torque_limit=limit, failed=failed, frames=tuple(frames)
    )


def draw_comparison(recordings: Sequence[Recording], path: Path, plant: PlantSpec = NOMINAL_PLANT) -> None:
    """Draws displacement over the episode, and torque, angle and contact over its last seconds, as one PNG.

    Args:
        recordings: one to four recordings on one plant, the baseline first.
        path: the PNG; written atomically.
        plant: the plant of the recordings.
    """
    title = f"{'Nominal plant' if plant == NOMINAL_PLANT else 'Plant'} (M = {plant.M:g} kg, μ = {plant.mu:g})"
    with style():
        figure = new_figure(6.2)
        displacement, angle, torque, contact = figure.subplots(4, 1, height_ratios=(1.5, 1.0, 1.0, 0.5))
        window = max(r.t[-1] for r in recordings)
        first = max(0.0, window - LAST)
        for place, (recording, colour) in enumerate(zip(recordings, (MUTED, BLUE, VERMILION, GREEN), strict=False)):
            speed = 100.0 * (recording.x[-1] - recording.x[0]) / recording.t[-1]
            shown = recording.t >= first
            label = f"{recording.name}: {speed:.2f} cm/s"
            displacement.plot(recording.t, 100.0 * recording.x, color=colour, label=label)
            angle.plot(recording.t[shown], np.degrees(recording.theta[shown]), color=colour)
            torque.step(recording.t[shown], recording.torque[shown], color=colour, lw=1.0, where="pre")
            # A lane that is dark while the platform sticks and pale while it slips.
            for where, alpha in ((shown, 0.2), (shown & (recording.x_dot == 0.0), 1.0)):
                lane: dict[str, Any] = {"color": colour, "alpha": alpha, "linewidth": 0.0, "step": "post"}
                contact.fill_between(recording.t, place - 0.35, place + 0.35, where=where, **lane)
        if plant.goal is not None:
            displacement.axhline(100.0 * plant.goal, color=INK, linewidth=0.8, linestyle=":", label="goal")
        displacement.set(title=title, xlabel="time (s)", ylabel="displacement x (cm)", xlim=(0.0, window))
        displacement.legend(loc="upper left")
        angle.set(ylabel="angle θ (deg)", xlim=(first, window))
        torque.set(ylabel="torque u (N m)", xlim=(first, window))
        contact.set(xlabel="time (s); dark: the platform sticks, pale: it slips", xlim=(first, window))
        contact.set_yticks(range(len(recordings)), [recording.name for recording in recordings])
        contact.set_ylim(len(recordings) - 0.5, -0.5)
        contact.grid(visible=False)
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=DPI)


def document() -> Document:
    """The animations."""
    shown = {**{name: (NOMINAL_PLANT, BEGIN, SECONDS) for name in POLICIES}, **TASK_POLICIES}
    return Document(figures={f"media/{name}.gif": partial(animate, name, *part) for name, part in shown.items()})


def animate(name: str, plant: PlantSpec, begin: float, seconds: float, path: Path) -> None:
    """Writes the animation of a policy as a GIF; a trained policy is shown with its first seed."""
    policy, every = find_candidate(name).policies[0], ANIMATION_FRAME_SECONDS
    recording = record(policy, plant, seconds=begin + seconds, frames_from=begin, frame_seconds=every, name=name)
    write_gif(recording.frames, path, every, 480)
