"""One episode seen from outside: the courses of its quantities, its figure and its moving picture."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.evaluation.candidates import find_candidate
from agents.evaluation.episodes import EPISODE_SETTINGS, Policy
from agents.evaluation.sets import HORIZON, PlantSpec
from baselines.policies import SCRIPTED
from capsule_gym.files import replacing
from capsule_gym.task import CONTROL_DT, EPISODE_STEPS

NOMINAL = PlantSpec(M=0.5, mu=0.01, seed=0)
NOMINAL_TITLE = "Nominal plant (M = 0.5 kg, μ = 0.01)"
# Agent steps between the frames of a moving picture: 25 a second, which a GIF can keep exactly.
FRAME_EVERY = 2


@dataclass(frozen=True)
class Recording:
    """The course of one episode, sampled once per agent step.

    Attributes:
        name: of the policy.
        t: s.
        theta: rad.
        x: m.
        torque: the motor's, N m.
        frames: pictures, each (height, width, 3) uint8; empty unless asked for.
    """

    name: str
    t: np.ndarray
    theta: np.ndarray
    x: np.ndarray
    torque: np.ndarray
    frames: tuple[np.ndarray, ...] = ()


def record(
    policy: Policy,
    plant: PlantSpec = NOMINAL,
    *,
    steps: int = EPISODE_STEPS,
    frame_every: int | None = None,
    frames_from: int = 0,
) -> Recording:
    """Runs a policy once on one plant, until `steps` or the episode's end.

    Args:
        policy: what acts.
        plant: the platform's mass and friction.
        steps: agent steps.
        frame_every: agent steps between pictures; None draws none.
        frames_from: the agent step of the first picture.
    """
    kwargs: dict[str, Any] = {**policy.env_kwargs, **EPISODE_SETTINGS}
    del kwargs["autoreset_mode"]
    mode = None if frame_every is None else "rgb_array"
    env = gym.make("CapsuleStickSlip-v0", render_mode=mode, max_episode_steps=steps, **kwargs)
    act = policy.start([plant.seed])
    rows, frames = [], []
    observation, info = env.reset(seed=plant.seed, options={"M": plant.M, "mu": plant.mu})
    for n in range(steps + 1):
        rows.append((n * CONTROL_DT, info["state"][0], info["state"][2], info["torque"]))
        if frame_every is not None and n >= frames_from and (n - frames_from) % frame_every == 0:
            frames.append(np.asarray(env.render()))
        if n == steps:
            break
        observation, _, terminated, _, info = env.step(act(observation[None])[0])
        if terminated:
            break
    env.close()
    t, theta, x, torque = np.array(rows).T
    return Recording(policy.name, t, theta, x, torque, tuple(frames))


def draw_comparison(recordings: Sequence[Recording], path: Path, title: str, seconds: float = 6.6) -> None:
    """Draws displacement over the episode, and torque and angle over its last seconds, as one PNG.

    Args:
        recordings: one or more, the baseline first.
        path: the PNG; written whole or not at all.
        title: of the figure.
        seconds: length of the windows of torque and angle.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    displacement, angle, torque = figure.subplots(3, 1, height_ratios=(1.5, 1.0, 1.0))
    window = max(r.t[-1] for r in recordings)
    first = max(0.0, window - seconds)
    colours = ("#6d7a8d", "#0d807c", "#ee8024", "#8b4cc7")
    for recording, colour in zip(recordings, colours, strict=False):
        speed = 100.0 * (recording.x[-1] - recording.x[0]) / recording.t[-1]
        shown = recording.t >= first
        displacement.plot(
            recording.t, 100.0 * recording.x, color=colour, lw=1.8, label=f"{recording.name}: {speed:.2f} cm/s"
        )
        angle.plot(recording.t[shown], np.degrees(recording.theta[shown]), color=colour, lw=1.2)
        # The torque on record at an agent step is the one of the step before it.
        torque.step(recording.t[shown], recording.torque[shown], color=colour, lw=1.2, where="pre")
    displacement.set(title=title, xlabel="time (s)", ylabel="displacement x (cm)", xlim=(0.0, window))
    displacement.legend(frameon=False, loc="upper left")
    angle.set(ylabel="angle θ (deg)", xlim=(first, window))
    torque.set(xlabel="time (s)", ylabel="torque u (N m)", xlim=(first, window))
    for axes in (displacement, angle, torque):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#e3e8ef", lw=0.7)
        axes.set_axisbelow(True)
    FigureCanvasAgg(figure)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)


def write_gif(
    frames: Sequence[np.ndarray], path: Path, frame_seconds: float = FRAME_EVERY * CONTROL_DT, width: int = 640
) -> None:
    """Writes pictures as a looping GIF.

    Args:
        frames: (height, width, 3) uint8 each.
        path: the GIF; written whole or not at all.
        frame_seconds: time between frames; GIF counts hundredths of a second.
        width: of the result, in pixels.

    Raises:
        ValueError: if there are no pictures.
    """
    if not frames:
        raise ValueError("frames must hold at least one picture, got none: the episode ended before the first")
    from PIL import Image

    pictures = [Image.fromarray(frame) for frame in frames]
    height = round(pictures[0].height * width / pictures[0].width)
    pictures = [picture.resize((width, height), Image.Resampling.LANCZOS) for picture in pictures]
    # One palette for all frames: colours do not flicker, and only what moves is stored anew.
    # By coverage, not by frequency: the few pixels of a legend keep their colour too.
    palette = pictures[len(pictures) // 2].quantize(128, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    pictures = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    with replacing(path) as temporary:
        pictures[0].save(
            temporary,
            save_all=True,
            append_images=pictures[1:],
            duration=round(1000 * frame_seconds),
            loop=0,
            optimize=True,
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m agents.recording",
        description="Draws a policy on the nominal plant: as a moving picture, or beside the paper's controller.",
        epilog="Model archives contain pickles: load only what you trust.",
    )
    parser.add_argument(
        "policy", metavar="NAME_OR_PATH", help="as for python -m agents.evaluate; the first training seed"
    )
    parser.add_argument("--gif", type=Path, metavar="FILE", help="write the moving picture to this file")
    parser.add_argument("--png", type=Path, metavar="FILE", help="write the figure to this file")
    parser.add_argument("--start", type=float, default=10.0, help="start of the moving picture, s (default: 10)")
    parser.add_argument("--seconds", type=float, default=6.0, help="length of the moving picture, s (default: 6)")
    options = parser.parse_args(arguments)
    for name, value in (("--start", options.start), ("--seconds", options.seconds)):
        if not 0.0 <= value <= HORIZON:
            parser.error(f"{name} must be between 0 and {HORIZON} s, got {value}")
    try:
        policy = find_candidate(options.policy).runs[0].load()
    except ValueError as error:
        parser.error(str(error))
    if options.png is not None:
        recordings = [record(SCRIPTED["adaptive"]), replace(record(policy), name=options.policy)]
        draw_comparison(recordings, options.png, NOMINAL_TITLE)
    if options.gif is not None:
        first = round(options.start / CONTROL_DT)
        last = first + round(options.seconds / CONTROL_DT)
        write_gif(record(policy, steps=last, frame_every=FRAME_EVERY, frames_from=first).frames, options.gif)
    return 0


if __name__ == "__main__":
    sys.exit(main())
