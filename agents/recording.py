"""Recordings of an episode: its time series, a figure that compares several, and an animation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.evaluation.policies import Policy
from baselines.drawing import BLUE, DPI, GREEN, MUTED, VERMILION, new_figure, style
from capsule_gym.evaluation_sets import EPISODE_SETTINGS, NOMINAL_PLANT, PlantSpec
from capsule_gym.files import replacing
from capsule_gym.rendering import FRAME_SECONDS, ChartAxes, Renderer
from capsule_gym.task import CONTROL_DT, HORIZON

NOMINAL_TITLE = f"Nominal plant (M = {NOMINAL_PLANT.M:g} kg, μ = {NOMINAL_PLANT.mu:g})"


@dataclass(frozen=True)
class Recording:
    """Time series of one episode, a sample per step of the agent.

    Attributes:
        name: of the policy.
        t: s.
        theta: rad.
        x: m.
        x_dot: m/s; exactly 0.0 where the platform sticks.
        torque: the motor's in the step that ends at t, N m.
        frames: pictures, each (height, width, 3) uint8; empty unless asked for.
    """

    name: str
    t: np.ndarray
    theta: np.ndarray
    x: np.ndarray
    x_dot: np.ndarray
    torque: np.ndarray
    frames: tuple[np.ndarray, ...] = ()


def record(
    policy: Policy,
    plant: PlantSpec = NOMINAL_PLANT,
    *,
    seconds: float = HORIZON,
    frames_from: float | None = None,
    frame_seconds: float = FRAME_SECONDS,
    name: str | None = None,
) -> Recording:
    """Runs a policy once on one plant, to the given time or the episode's end.

    Args:
        policy: acts.
        plant: the platform's mass and friction.
        seconds: length of the recording.
        frames_from: time of the first picture, s; None draws none.
        frame_seconds: time between pictures. The axes of their charts are the same.
        name: of the recording; the policy's by default.
    """
    # Imported here, since numba takes most of a second to import.
    from capsule_gym.env import shown_state

    name = name or policy.name
    settings: dict[str, Any] = {**policy.env_kwargs, **EPISODE_SETTINGS}
    dt = settings.get("control_dt", CONTROL_DT)
    steps, frame_every = round(seconds / dt), round(frame_seconds / dt)
    env = gym.make("CapsuleStickSlip-v0", max_episode_steps=steps, **settings)
    simulation = env.unwrapped.simulation  # type: ignore[attr-defined]
    renderer, first_frame = None, steps + 1
    if frames_from is not None:
        first_frame = round(frames_from / dt)
        renderer = Renderer(simulation.capsule, "rgb_array", 50, simulation.settings.torque_limit, name)
        whole = record(policy, plant, seconds=seconds)
        shown = 100.0 * whole.x[whole.t >= frames_from]
        low, high = (float(shown.min()), float(shown.max())) if shown.size else (0.0, 0.0)
        length = max(float(whole.t[-1]) - frames_from, FRAME_SECONDS)
        renderer.set_axes(ChartAxes(frames_from, length, low, max(high, low + 1.0)))
    act = policy.start([plant.seed])
    rows, frames, terminated = [], [], False
    start = [plant.theta, 0.0, 0.0, 0.0]
    observation, info = env.reset(seed=plant.seed, options={"M": plant.M, "mu": plant.mu, "state": start})
    for n in range(steps + 1):
        theta, _, x, x_dot = info["state"]
        rows.append((n * dt, theta, x, x_dot, info["torque"]))
        if renderer is not None and n >= first_frame and (n - first_frame) % frame_every == 0:
            frames.append(np.asarray(renderer.draw(**shown_state(simulation, 0))))
        if terminated or n == steps:
            break
        observation, _, terminated, _, info = env.step(act(observation[None])[0])
    env.close()
    t, theta_series, x_series, x_dot_series, torque = np.array(rows).T
    return Recording(name, t, theta_series, x_series, x_dot_series, torque, tuple(frames))


def draw_comparison(recordings: Sequence[Recording], path: Path, title: str, seconds: float = 6.6) -> None:
    """Draws displacement over the episode, and torque, angle and contact over its last seconds, as one PNG.

    Args:
        recordings: one to four, the baseline first.
        path: the PNG; written atomically.
        title: of the figure.
        seconds: length of the windows of torque, angle and contact.
    """
    with style():
        figure = new_figure(6.2)
        displacement, angle, torque, contact = figure.subplots(4, 1, height_ratios=(1.5, 1.0, 1.0, 0.5))
        window = max(r.t[-1] for r in recordings)
        first = max(0.0, window - seconds)
        for place, (recording, colour) in enumerate(zip(recordings, (MUTED, BLUE, VERMILION, GREEN), strict=False)):
            speed = 100.0 * (recording.x[-1] - recording.x[0]) / recording.t[-1]
            shown = recording.t >= first
            label = f"{recording.name}: {speed:.2f} cm/s"
            displacement.plot(recording.t, 100.0 * recording.x, color=colour, label=label)
            angle.plot(recording.t[shown], np.degrees(recording.theta[shown]), color=colour)
            torque.step(recording.t[shown], recording.torque[shown], color=colour, lw=1.0, where="pre")
            # A lane that is dark where the platform sticks and pale where it slips.
            for where, alpha in ((shown, 0.2), (shown & (recording.x_dot == 0.0), 1.0)):
                lane: dict[str, Any] = {"color": colour, "alpha": alpha, "linewidth": 0.0, "step": "post"}
                contact.fill_between(recording.t, place - 0.35, place + 0.35, where=where, **lane)
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
