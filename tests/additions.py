"""Adds a made-up one of each kind to a copy of the sources: `python -m tests.additions`.

CONTRIBUTING.md says where a metric, a disturbance, a constant of the plant, an entry of the
observation, a control law in C++ and a task are added. This command adds one of each, counts the
files, installs the copy, and looks for all six in Python and in WebAssembly.
"""

import subprocess
import sys
import tempfile
import venv
from pathlib import Path
from typing import NamedTuple

from capsule_gym.command_line import command
from tests import ROOT

CORE = "capsule_gym/core"


class Change(NamedTuple):
    """Text that is inserted behind a text in a file; a new file where there is none."""

    path: str
    behind: str
    text: str


# The largest number of files that an addition may touch, and its changes.
ADDITIONS: dict[str, tuple[int, list[Change]]] = {
    "metric": (
        2,
        [
            Change(
                f"{CORE}/step/metrics.hpp",
                'put("duration", "length of the episode, s", b.duration[j]);\n',
                '  put("made_up_metric", "twice the length of the episode, s", 2.0 * b.duration[j]);\n',
            ),
        ],
    ),
    "disturbance": (
        2,
        [
            Change(
                f"{CORE}/step/disturbances.hpp", "FIELD(torque_resolution) ", "FIELD(made_up_gain) "
            ),
            Change(
                f"{CORE}/step/disturbances.hpp",
                "  return motor + share * (rounded(command, d.torque_resolution) - motor)",
                " + d.made_up_gain * motor",
            ),
            Change(
                "capsule_gym/parameters/disturbances.py",
                "    torque_resolution: Draws = 0.0\n",
                "    made_up_gain: Draws = 0.0\n",
            ),
        ],
    ),
    "constant": (
        3,
        [
            Change(
                f"{CORE}/physics/plant.hpp", "FIELD(stribeck_excess) ", "FIELD(made_up_constant) "
            ),
            Change(
                f"{CORE}/physics/plant.hpp", "FIELD(stribeck_speed) ", "FIELD(made_up_constant) "
            ),
            Change(
                f"{CORE}/physics/plant.hpp",
                "  p.downhill = given.g * sin",
                ", p.made_up_constant = given.made_up_constant",
            ),
            Change(
                f"{CORE}/physics/plant.hpp",
                "  return given.viscous != 0.0",
                " || given.made_up_constant != 0.0",
            ),
            Change(
                "capsule_gym/parameters/capsule.py",
                "    viscous: float\n",
                "    made_up_constant: float\n",
            ),
            Change(
                "capsule_gym/parameters/capsule.py",
                "    slope: float = 0.0\n",
                "    made_up_constant: float = 0.0\n",
            ),
            Change(
                "capsule_gym/parameters/randomization.py",
                "    slope: Range | None = None\n",
                "    made_up_constant: Range | None = None\n",
            ),
        ],
    ),
    "entry": (
        2,
        [
            Change(
                f"{CORE}/step/observation.hpp",
                'put("last_action", -1.0, 1.0, o.action);\n',
                # Only with a sensor of x, so that trained policies still fit their environments.
                '  if (q.with_x != 0.0) put("made_up_entry", -1.0, 1.0, 0.5 * o.action);\n',
            ),
        ],
    ),
    "law": (
        2,
        [
            Change(
                f"{CORE}/laws/made_up.hpp",
                "",
                """#pragma once
#include "law.hpp"

namespace LEVEL {
struct MadeUp {
#define MADE_UP_CONSTANTS(ONE, MANY) ONE(gain)
  CAPSULE_LAW(MadeUp, "made_up", T, NoMemory, NoReference, MADE_UP_CONSTANTS)

  template <class T> INLINE T torque(const State<T>& s, NoMemory<T>&, const NoReference<T>&) const {
    return -q.gain * s.theta_dot;
  }
};
}  // namespace LEVEL
""",
            ),
            Change(f"{CORE}/laws/laws.hpp", '#include "gait.hpp"\n', '#include "made_up.hpp"\n'),
            Change(f"{CORE}/laws/laws.hpp", "Tracking, Oscillator", ", MadeUp"),
        ],
    ),
    "task": (
        3,
        [
            Change(
                f"{CORE}/tasks/made_up.hpp",
                "",
                """#pragma once
#include "task.hpp"

namespace LEVEL {
struct MadeUpTask {
  static constexpr const char *NAME = "made_up_task", *FIELDS = "level ", *SHOWN = "level ", *TERM = "reward_made_up";
  static constexpr int STEPS = 100;
  template <class T> struct Memory { T level; };

  template <class Put> static void draws(Range, Put put) { put("level", 1.0, 2.0, UNIFORM); }

  template <class T> static INLINE void begin(T, T, Memory<T>&) {}

  template <class T> static INLINE T reward(T, T, T moved, double, double, Memory<T>& m) { return m.level * moved; }

  template <class T, class Put> static INLINE void observe(const Memory<T>& m, Put put) {
    put("level", 0.0, 2.0, m.level);
  }

  template <class Put> static void metrics(const Memory<double>& m, double, Put put) {
    put("made_up_level", "the level", m.level);
  }
};
}  // namespace LEVEL
""",
            ),
            Change(f"{CORE}/tasks/tasks.hpp", '#include "goal.hpp"\n', '#include "made_up.hpp"\n'),
            Change(f"{CORE}/tasks/tasks.hpp", "List<Speed, Goal, Velocity", ", MadeUpTask"),
            Change(
                "capsule_gym/tasks/registry.py",
                "TASKS = {task.name: task for task in (speed.TASK, goal.TASK, velocity.TASK",
                ', Task(name="made_up_task", env_id="CapsuleMadeUp-v0")',
            ),
        ],
    ),
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
assert info["level"] == 1.5 and env.unwrapped.episode_metrics(100)["made_up_level"] == 1.5
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
assert.equal(capsule.reset({ disturbances: { made_up_gain: 0.15 } }).info.disturbances.made_up_gain, 0.15);
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
    """Makes all changes in a copy of the sources.

    Raises:
        ValueError: if an addition touches more files than it may, or the sources lack a text.
    """
    for name, (most, changes) in ADDITIONS.items():
        touched = {change.path for change in changes}
        if len(touched) > most:
            raise ValueError(f"a {name} must touch at most {most} files, got {sorted(touched)}")
        for change in changes:
            path = folder / change.path
            text = path.read_text(encoding="utf-8") if path.exists() else ""
            if change.behind not in text:
                raise ValueError(f"{change.path} must contain {change.behind!r}")
            path.write_text(
                text.replace(change.behind, change.behind + change.text, 1), encoding="utf-8"
            )


def run(*words: str | Path, cwd: Path) -> None:
    """Runs a program in a folder."""
    subprocess.run([str(word) for word in words], cwd=cwd, check=True)


@command("python -m tests.additions", ValueError, subprocess.CalledProcessError)
def main() -> None:
    """Adds a made-up metric, disturbance, constant, entry, law and task, and looks for them in
    Python and WebAssembly.

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
