"""Speed of the module for browsers and of the live page: `python -m benchmarks.web`.

Whole episodes of one capsule in closed loop, in this process and in node on the same machine, take turns; the page then
runs in a headless browser. All times are the processor's, so that a busy machine changes little. The page's time
is that of its own thread, which simulates, lays out and issues what is drawn, without the browser's other threads.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import capsule_gym
from baselines.tables import markdown_table, text_table
from benchmarks.measurement import OutputArgs, Rate, describe, machine
from capsule_gym.command_line import Count, parse, refuse
from capsule_gym.task import EPISODE_STEPS
from web import build
from web.controllers import is_trained
from web.episodes import env_kwargs

COMMAND = "python -m benchmarks.web"
# Nothing in the step, a law, a network, and both with a filter.
CONTROLLERS = ("zero", "adaptive", "direct-ppo", "robust")
# Runs an episode for every line of its input; prints its seconds.
SCRIPT = """
import { createInterface } from "node:readline";
const [path, name] = process.argv.slice(1);
const { drive } = await import(path);
const episode = await drive(name);
for await (const _ of createInterface({ input: process.stdin })) {
  const start = process.cpuUsage();
  episode.reset();
  for (let step = 0; step < episode.horizon; step++) episode.tick();
  const { user, system } = process.cpuUsage(start);
  console.log((user + system) / 1e6);
}
"""
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SIZE = {"width": 1280, "height": 800}
WARM_UP = 1000
SCENES = {
    "adaptive": "#driver=adaptive",
    "robust and adaptive": "#driver=robust&rival=adaptive",
    "robust and adaptive, two lanes": "#driver=robust&rival=adaptive&view=lane",
    "residual-ppo and adaptive": "#driver=residual-ppo&rival=adaptive",
    "robust and adaptive, 5 times as fast": "#driver=robust&rival=adaptive&speed=5",
}
COUNT_FRAMES = """
window.frames_taken = 0;
const request = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (callback) => {
  window.frames_taken += 1;
  return request(callback);
};
"""


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Speed of one capsule in node, compared with the native environment, and of the live page in a browser.

    Examples:
        python -m benchmarks.web --markdown docs/live_speed.md
    """

    turns: Count = 15
    """Episodes of every controller, native and in node."""
    seconds: Count = 5
    """Duration of each scene of the page."""


def native_episode(name: str) -> float:
    """A nominal episode of Python's environment, as a user steps it; returns its seconds. No controller fails in it."""
    env = capsule_gym.CapsuleEnv(**env_kwargs(name))
    policy = capsule_gym.load_policy(name) if is_trained(name) else None
    nothing, nominal = np.zeros(1, np.float32), {"M": env.simulation.capsule.M, "mu": env.simulation.capsule.mu}
    start = time.process_time()
    observation, _ = env.reset(options=nominal)
    act = policy.start([0]) if policy else None
    for _ in range(EPISODE_STEPS):
        observation, *_ = env.step(act(observation) if act else nothing)
    seconds = time.process_time() - start
    env.close()
    return seconds


@contextmanager
def node_process(name: str, module: Path) -> Iterator[Callable[[], float]]:
    """A process of node; yields the function that runs a nominal episode in it and returns its seconds."""
    command = ["node", "--input-type=module", "--eval", SCRIPT, module.as_uri(), name]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        orders, answers = process.stdin, process.stdout

        def episode() -> float:
            print(file=orders, flush=True)
            return float(answers.readline())

        yield episode


def measure(module: Path, turns: int) -> dict[str, dict[str, Rate]]:
    """Agent steps per second by controller and place, native or in node; the first turn only warms up."""
    with ExitStack() as stack:
        episodes: dict[tuple[str, str], Callable[[], float]] = {}
        for name in CONTROLLERS:
            episodes[name, "native"] = partial(native_episode, name)
            episodes[name, "node"] = stack.enter_context(node_process(name, module))
        found: dict[tuple[str, str], list[float]] = {key: [] for key in episodes}
        for _ in tqdm(range(turns + 1), desc="turns"):
            for key, episode in episodes.items():
                found[key].append(EPISODE_STEPS / episode())
    return {name: {place: Rate.of(found[name, place][1:]) for place in ("native", "node")} for name in CONTROLLERS}


def find_browser() -> str | None:
    """The path of one of `BROWSERS`; None where this machine has none."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


@contextmanager
def started(executable: str) -> Iterator[Any]:
    """A headless browser as playwright shows it."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        yield browser
        browser.close()


def frames(browser: Any, address: str, seconds: int) -> tuple[int, float]:
    """The frames of a scene, and the processor's seconds of the page's thread for them.

    Args:
        browser: from `started`.
        address: of the page, with its scene.
        seconds: duration.
    """
    page = browser.new_page(viewport=SIZE, reduced_motion="no-preference")
    page.add_init_script(COUNT_FRAMES)
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def count() -> tuple[int, float]:
        metrics = {each["name"]: each["value"] for each in session.send("Performance.getMetrics")["metrics"]}
        return page.evaluate("window.frames_taken"), metrics["TaskDuration"]

    page.goto(address)
    page.wait_for_timeout(WARM_UP)
    before, busy = count()
    page.wait_for_timeout(1000 * seconds)
    last, total = count()
    page.close()
    return last - before, total - busy


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    executable = find_browser()
    if executable is None or shutil.which("node") is None or find_spec("playwright") is None:
        refuse(COMMAND, f"node, a browser ({', '.join(BROWSERS)}) and playwright must be installed")
    found = machine("playwright")
    steps = [["controller", "native, steps/s", "IQR", "node, steps/s", "IQR", "node over native"]]
    scenes = [["scene", "frames/s", "ms per frame", "of 1/60 s"]]
    with tempfile.TemporaryDirectory() as folder:
        build.main(["--output", folder])
        rates = measure(Path(folder) / "capsule.mjs", args.turns)
        with started(executable) as browser:
            for name, scene in SCENES.items():
                count, busy = frames(browser, (Path(folder) / "index.html").as_uri() + scene, args.seconds)
                each = busy / count
                scenes.append([name, f"{count / args.seconds:.0f}", f"{1e3 * each:.1f}", f"{60.0 * each:.0%}"])
    for name, places in rates.items():
        cells = [cell for rate in places.values() for cell in (f"{rate.median:,.0f}", f"{rate.spread:.0%}")]
        steps.append([name, *cells, f"{places['node'].median / places['native'].median:.3f}"])
    note = (
        f"Agent steps, of 20 ms each, of one capsule in closed loop per second of the processor; medians of "
        f"{args.turns} episodes. Frames of {SIZE['width']} by {SIZE['height']} pixels. {describe(found)}."
    )
    print(text_table(steps), text_table(scenes, left=1, last_left=False), note, sep="\n\n")
    numbers = {"machine": found, "turns": args.turns, "steps": steps, "seconds": args.seconds, "scenes": scenes}
    args.write(COMMAND, numbers, f"{markdown_table(steps)}\n\n{markdown_table(scenes)}\n\n{note}".split("\n"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
