"""Adds a made-up one of each kind to a copy of the sources: `python -m tests.additions`.

CONTRIBUTING.md says where a metric, a disturbance, a constant of the plant, an entry of the
observation, a control law in C++ and a task are added. This command adds one of each, counts the
files, installs the copy, and looks for all six in Python and in WebAssembly.
"""

import subprocess
import sys
import tempfile
import venv
from collections.abc import Callable
from pathlib import Path

from capsule_gym.command_line import command
from tests import ROOT

CORE = "capsule_gym/core"
PARAMETERS = "capsule_gym/parameters"


class Sources:
    """A copy of the sources, and the files that have been touched."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.touched: set[str] = set()

    def insert(self, path: str, behind: str, text: str) -> None:
        """Inserts a text behind another one.

        Raises:
            ValueError: if the file lacks the other text.
        """
        source = (self.folder / path).read_text(encoding="utf-8")
        if behind not in source:
            raise ValueError(f"{path} must contain {behind!r}")
        self.write(path, source.replace(behind, behind + text, 1))

    def write(self, path: str, text: str) -> None:
        """Writes a file."""
        self.touched.add(path)
        (self.folder / path).write_text(text, encoding="utf-8")


def add_metric(sources: Sources) -> None:
    """Adds twice the length of an episode."""
    sources.insert(
        f"{CORE}/step/metrics.hpp",
        'put("duration", "length of the episode, s", b.duration[j]);\n',
        '  put("made_up_metric", "twice the length of the episode, s", 2.0 * b.duration[j]);\n',
    )


def add_disturbance(sources: Sources) -> None:
    """Adds a gain of the motor."""
    header = f"{CORE}/step/disturbances.hpp"
    sources.insert(header, "FIELD(torque_resolution)", " FIELD(made_up_gain)")
    effect = "  return motor + share * (rounded(command, d.torque_resolution) - motor)"
    sources.insert(header, effect, " + d.made_up_gain * motor")
    field = "    torque_resolution: Draws = 0.0\n"
    sources.insert(f"{PARAMETERS}/disturbances.py", field, "    made_up_gain: Draws = 0.0\n")


def add_constant(sources: Sources) -> None:
    """Adds a constant of the plant without an effect."""
    header = f"{CORE}/physics/plant.hpp"
    sources.insert(header, "FIELD(stribeck_excess)", " FIELD(made_up_constant)")
    sources.insert(header, "FIELD(stribeck_speed)", " FIELD(made_up_constant)")
    derived = "  p.downhill = given.g * sin;\n"
    sources.insert(header, derived, "  p.made_up_constant = given.made_up_constant;\n")
    extends = "  return given.viscous != 0.0"
    sources.insert(header, extends, " || given.made_up_constant != 0.0")
    capsule = f"{PARAMETERS}/capsule.py"
    sources.insert(capsule, "    viscous: float\n", "    made_up_constant: float\n")
    default = "    slope: float = 0.0\n"
    sources.insert(capsule, default, "    made_up_constant: float = 0.0\n")
    default = "    slope: Range | None = None\n"
    field = "    made_up_constant: Range | None = None\n"
    sources.insert(f"{PARAMETERS}/randomization.py", default, field)


def add_entry(sources: Sources) -> None:
    """Adds an entry only with a sensor of x, so that trained policies still fit."""
    sources.insert(
        f"{CORE}/step/observation.hpp",
        'put("last_action", -1.0, 1.0, o.action);\n',
        '  if (settings.with_x != 0.0) put("made_up_entry", -1.0, 1.0, 0.5 * o.action);\n',
    )


LAW = """#pragma once
#include "law.hpp"

namespace LEVEL {
struct MadeUp {
#define MADE_UP_CONSTANTS(ONE, MANY) ONE(gain)
  CAPSULE_LAW(MadeUp, "made_up", T, NoMemory, NoReference, MADE_UP_CONSTANTS)

  template <class T> INLINE T torque(const State<T>& s, NoMemory<T>&, const NoReference<T>&) const {
    return -gain * s.theta_dot;
  }
};
}  // namespace LEVEL
"""


def add_law(sources: Sources) -> None:
    """Adds a damper."""
    sources.write(f"{CORE}/laws/made_up.hpp", LAW)
    laws = f"{CORE}/laws/laws.hpp"
    sources.insert(laws, '#include "gait.hpp"\n', '#include "made_up.hpp"\n')
    sources.insert(laws, "Tracking, Oscillator", ", MadeUp")


TASK = """#pragma once
#include "task.hpp"

namespace LEVEL {
struct MadeUpTask {
  static constexpr const char* NAME = "made_up_task";
  static constexpr const char* FIELDS = "level ";
  static constexpr const char* SHOWN = "level ";
  static constexpr const char* TERM = "reward_made_up";
  static constexpr int STEPS = 100;
  template <class T> struct Memory { T level; };

  static void draws(Range, auto put) { put("level", 1.0, 2.0, UNIFORM); }

  template <class T> static INLINE void begin(T, T, Memory<T>&) {}

  template <class T> static INLINE T reward(T, T, T moved, double, double, Memory<T>& m) {
    return m.level * moved;
  }

  template <class T> static INLINE void observe(const Memory<T>& m, auto put) {
    put("level", 0.0, 2.0, m.level);
  }

  static void metrics(const Memory<double>& m, double, auto put) {
    put("made_up_level", "the level", m.level);
  }
};
}  // namespace LEVEL
"""


def add_task(sources: Sources) -> None:
    """Adds a task whose reward is the distance times a number that the episode draws."""
    sources.write(f"{CORE}/tasks/made_up.hpp", TASK)
    tasks = f"{CORE}/tasks/tasks.hpp"
    sources.insert(tasks, '#include "goal.hpp"\n', '#include "made_up.hpp"\n')
    sources.insert(tasks, "List<Speed, Goal, Velocity", ", MadeUpTask")
    registered = "TASKS = {task.name: task for task in (speed.TASK, goal.TASK, velocity.TASK"
    entry = ', Task(name="made_up_task", env_id="CapsuleMadeUp-v0")'
    sources.insert("capsule_gym/tasks/registry.py", registered, entry)


# Each addition, with the largest number of files that it may touch.
ADDITIONS: dict[Callable[[Sources], None], int] = {
    add_metric: 2,
    add_disturbance: 2,
    add_constant: 3,
    add_entry: 2,
    add_law: 2,
    add_task: 3,
}

# What Python must show.
PYTHON = """
import gymnasium as gym
import numpy as np
from capsule_gym import Capsule, CapsuleEnv, Controller, Disturbances, Randomization
from capsule_gym.control.controller import CoreLaw

env = CapsuleEnv(
    disturbances=Disturbances(made_up_gain=(0.1, 0.2), x_noise=0.001),
    randomization=Randomization(made_up_constant=(0.3, 0.4)),
)
observation, info = env.reset(seed=0)
assert 0.1 <= info["disturbances"]["made_up_gain"] <= 0.2
assert 0.3 <= info["capsule"]["made_up_constant"] <= 0.4
_, info = env.reset(options={"disturbances": {"made_up_gain": 0.15}})
assert info["disturbances"]["made_up_gain"] == 0.15
assert list(env.simulation.entries)[-1] == "made_up_entry"
observation, *_ = env.step(np.ones(1, np.float32))
assert observation[-1] == 0.5
metrics = env.episode_metrics(None)
assert metrics["made_up_metric"] == 2.0 * metrics["duration"] > 0.0
law = Controller("made-up", CoreLaw("made_up", gain=0.1), np.zeros((1, 2)))
driven = CapsuleEnv(controller=law, capsule=Capsule(made_up_constant=1.0))
driven.reset(options={"state": [0.0, 1.0, 0.0, 0.0]})
assert driven.simulation.settings.made_up_constant == 1.0
*_, info = driven.step(np.zeros(1, np.float32))
assert -0.1 < info["law_torque"] < 0.0
env = gym.make("capsule_gym:CapsuleMadeUp-v0")
_, info = env.reset(seed=0, options={"level": 1.5})
assert info["level"] == 1.5
assert env.unwrapped.episode_metrics(100)["made_up_level"] == 1.5
*_, info = env.step(np.ones(1, np.float32))
assert info["reward_made_up"] == 1.5 * info["state"][2]
"""

# Writes capsule.mjs with the law as one of its controllers.
BUILD = """
from pathlib import Path
import numpy as np
from capsule_gym import Controller
from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.laws import LAWS

LAWS["made_up"] = lambda: Controller("made_up", CoreLaw("made_up", gain=0.1), np.zeros((1, 2)))
from web.build import build_module, compile_wasm
from web.data import pack_data

Path("capsule.mjs").write_text(build_module(pack_data(compile_wasm())))
"""

# What WebAssembly must show.
JAVASCRIPT = """
import assert from "node:assert";
import { load } from "./capsule.mjs";

const capsule = await load("made_up", {
  disturbances: { made_up_gain: [0.1, 0.2], x_noise: 0.001 },
  options: { made_up_constant_low: 0.3, made_up_constant_high: 0.4 },
});
let { info } = capsule.reset({ seed: 0, theta_dot: 1 });
assert(info.disturbances.made_up_gain >= 0.1 && info.disturbances.made_up_gain <= 0.2);
assert(info.capsule.made_up_constant >= 0.3 && info.capsule.made_up_constant <= 0.4);
({ info } = capsule.reset({ disturbances: { made_up_gain: 0.15 } }));
assert.equal(info.disturbances.made_up_gain, 0.15);
const place = capsule.description.entries.findIndex(([name]) => name === "made_up_entry");
capsule.reset({ theta_dot: 1 });
const step = capsule.step(1);
assert.equal(step.observation[place], 0.5);
assert(step.info.law_torque < 0);
const { made_up_metric, duration } = capsule.metrics;
assert.equal(made_up_metric, 2 * duration);

const task = await load("direct", { task: "made_up_task" });
task.reset({ level: 1.5 });
({ info } = task.step(1));
assert.equal(info.level, 1.5);
assert.equal(task.metrics.made_up_level, 1.5);
"""


def add_all(folder: Path) -> None:
    """Makes all additions in a copy of the sources.

    Raises:
        ValueError: if an addition touches more files than it may, or the sources lack a text.
    """
    for add, most in ADDITIONS.items():
        sources = Sources(folder)
        add(sources)
        touched = sorted(sources.touched)
        if len(touched) > most:
            raise ValueError(f"{add.__name__} must touch at most {most} files, got {touched}")


def run(*words: str | Path, cwd: Path) -> None:
    """Runs a program in a folder."""
    subprocess.run([str(word) for word in words], cwd=cwd, check=True)


@command("python -m tests.additions", ValueError, subprocess.CalledProcessError)
def main() -> None:
    """Adds a made-up one of each kind, and looks for them in Python and WebAssembly.

    Examples:
      python -m tests.additions
    """
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name, "copy")
        run("git", "checkout-index", "--all", f"--prefix={copy}/", cwd=ROOT)
        add_all(copy)
        environment = Path(name, "environment")
        venv.create(environment, with_pip=True)
        python = environment / "bin" / "python"
        words = "-m pip install --quiet -c constraints.txt -e .[paper,render] ziglang"
        run(python, *words.split(), cwd=copy)
        run(python, "-c", PYTHON, cwd=copy)
        run(python, "-c", BUILD, cwd=copy)
        (copy / "additions.mjs").write_text(JAVASCRIPT, encoding="utf-8")
        run("node", "additions.mjs", cwd=copy)
    print(f"All {len(ADDITIONS)} additions are there.")


if __name__ == "__main__":
    sys.exit(main())
