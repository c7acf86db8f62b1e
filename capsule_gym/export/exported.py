"""Exports a policy, and the control law that it acts on, as C99 or as an ONNX model.

The loops of the network are in `policy.h.jinja`; everything else is recorded from the core
(`c_code`).
"""

import hashlib
import re
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.control.controller import Controller, CoreLaw
from capsule_gym.control.lookup import find_controller
from capsule_gym.core import _core
from capsule_gym.core.layout import STATE, Row
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.env import CapsuleEnv
from capsule_gym.envs.simulation import Simulation
from capsule_gym.evaluation.sets import EPISODE_SETTINGS, EvaluationSet, load_set
from capsule_gym.export.c_code import c_number, c_table, to_c
from capsule_gym.export.onnx_model import to_onnx
from capsule_gym.parameters import Disturbances
from capsule_gym.policies.loading import load_policy
from capsule_gym.tasks.registry import find_task

# The templates, and the folder in which they find the operations in C that they share with the
# core.
FOLDERS = (Path(__file__).parent, Path(__file__).parents[1])
LAW_REFERENCE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
# What a header's law writes to the reading.
SHOWN_OF_LAW = ("theta_d", "theta_d_dot", "phase", "law_torque")
# What a task adds to the reading.
TARGETS = {"goal": "goal", "velocity": "command"}
# Control intervals of the test vectors; a law alone has a quarter.
INTERVALS = 100


class Exported:
    """A policy or a control law with what its code needs.

    Args:
        name_or_path: as for `load_policy`; or the import string of a control law, such as
            "baselines:adaptive"; or a control law.
        law: whether the policy's control law is exported, too.

    Raises:
        TypeError: if the import string names something else.
        ValueError: if there is no such policy or law, or the law is not part of the core.
    """

    def __init__(self, name_or_path: str | Controller, law: bool = False) -> None:
        if isinstance(name_or_path, Controller) or LAW_REFERENCE.fullmatch(name_or_path):
            law = True
            self.policy = None
            self.cell = None
            self.controller = find_controller(name_or_path)
            own_task = getattr(self.controller, "task", None) or "speed"
            self.env_kwargs: dict[str, Any] = {
                "controller": name_or_path,
                "task": find_task(own_task).name,
            }
            self.options = EnvConfig(**self.env_kwargs)
            shown = name_or_path.name if isinstance(name_or_path, Controller) else name_or_path
            name = shown.rpartition(":")[2]
            self.description = f"control law {shown}"
        else:
            self.policy = load_policy(name_or_path)
            self.env_kwargs = self.policy.env_kwargs
            self.options = EnvConfig(**self.env_kwargs)
            self.controller = find_controller(self.options.controller)
            name = self.policy.name
            self.description = self.policy.description
            self.scale = 1.0 / np.sqrt(self.policy.variance + self.policy.epsilon)
            self.cell = self.policy.cell
            linear = (*self.policy.layers, *self.policy.head)
            widths = [weights.shape[1] for weights, _ in linear]
            if self.cell:
                widths.append(self.cell.weight_ih.shape[1])
            self.widest = max(widths)
        self.name = re.sub(r"\W|^(?=\d)", "_", name, flags=re.ASCII)
        self.law = self.controller if law else None
        if law and not isinstance(getattr(self.controller, "law", None), CoreLaw):
            found = self.options.controller or "a policy without a control law"
            raise ValueError(
                f"--law needs a control law of the core, such as baselines:adaptive, got {found}"
            )
        simulation = Simulation(1, self.options)
        self.task = simulation.task
        self.settings = simulation.settings
        self.layout = simulation.layout
        self.constants = simulation.fields["settings"]
        self.observed = simulation.entries
        entries = len(simulation.entries) // self.options.stack_size
        self.entries = [f"observation[{n}]" for n in range(entries)]
        self.reading = [*STATE, "action"]
        self._computed = ("action", *SHOWN_OF_LAW) if self.law else ("action",)
        if self.controller:
            self.reading += SHOWN_OF_LAW
        if self.options.observe_parameters:
            self.reading += ["M", "mu"]
        if self.task.name in TARGETS:
            self.reading.append(TARGETS[self.task.name])

    def c(self, *, single: bool = False) -> str:
        """The C99 header, which computes in float or in double.

        In double it has the bits of this package.
        """
        task = self.task
        # The task's memory but for what an episode draws.
        kept = task.rows - sum(task.option_sizes.values())
        task_inputs = self._task_inputs(kept)
        task_outputs: list[str | None] = [None] * task.rows
        task_outputs[:kept] = (f"memory->task[{n}]" for n in range(kept))
        observed = [*task_inputs, "reading->x", "before.x", "before.begun"]
        observed += [f"reading->{name}" if name in self.reading else "0" for name in _core.OBSERVED]
        filtered = [f"estimates[{n}]" for n in range(_core.ESTIMATOR_CELLS)]
        estimates = [f"memory->{cell}" for cell in filtered]
        filter_inputs = [f"before.{cell}" for cell in filtered]
        filter_inputs += [f"(REAL)observation[{n}]" for n in range(3)]
        law_cells = [f"law[{n}]" for n in range(len(self.law.memory))] if self.law else []
        law_inputs = [f"before.{cell}" for cell in law_cells]
        law_inputs += [f"reading->{name}" for name in STATE]
        if self.law:
            law_inputs += [f"row[{n}]" for n in range(self.law.reference.shape[1])]
            law_inputs += task_inputs if self.law.task else []
        return self._render(
            "policy.h.jinja",
            single,
            code=partial(to_c, single=single),
            kept=kept,
            # The rest of a reading is what the header itself computes.
            given=[name for name in self.reading if name not in self._computed],
            task_inputs=task_inputs,
            task_outputs=task_outputs,
            observed=observed + estimates,
            entry_names=self.observed,
            filter_inputs=filter_inputs,
            estimates=estimates,
            law_inputs=law_inputs,
            law_outputs=["torque", *(f"memory->{cell}" for cell in law_cells)],
            version=version("capsule-gym"),
        )

    def _task_inputs(self, kept: int) -> list[str]:
        """The task's memory as inputs: the first `kept` numbers remain, an episode draws others."""
        fields = self.task.fields
        inputs = {name: f"before.task[{n}]" for n, name in enumerate(fields)}
        # Goal and command are given instead; a new command ends the last one.
        given = dict.fromkeys(fields[kept:], "0") | {
            "v_0": "reading->command",
            "v_1": "reading->command",
            "goal": "reading->goal",
            "displacement": "(reading->goal - reading->x)",
            "lasts": "(reading->command == before.task[0] ? HUGE_VAL : 0)",
        }
        return [given.get(name, memory) for name, memory in inputs.items()]

    def c_test(self, file: str, *, single: bool = False) -> str:
        """A C99 program that checks the header `file` on the first episode of an evaluation set."""
        chosen = self._test_set()
        periods = int(self.settings.law_steps) if self.law else 1
        readings, actions = self._record(chosen, periods)
        columns = [name for name in self.reading if name not in self._computed]
        return self._render(
            "policy_test.c.jinja",
            single,
            file=file,
            set=chosen.name,
            columns=columns,
            given=[[reading[name] for name in columns] for reading in readings],
            actions=actions,
            torques=[reading["law_torque"] for reading in readings],
            periods=periods,
            tolerance=1e-3 if self.settings.with_estimates else 2e-5,
        )

    def _test_set(self) -> EvaluationSet:
        """The evaluation set of the test vectors."""
        if Disturbances.named(self.options.disturbances):
            return load_set("real")
        return load_set("paper" if self.task.name == "speed" else self.task.name)

    def _record(
        self, chosen: EvaluationSet, periods: int
    ) -> tuple[list[dict[str, float]], list[float]]:
        """What each call of the law reads in an episode, and the action of each agent step."""
        kwargs = {**chosen.env_kwargs, **self.env_kwargs, **EPISODE_SETTINGS}
        disturbed = Disturbances.named(self.options.disturbances)
        # The header has one reading for agent and law.
        if disturbed and disturbed.controls == "law":
            # An exact sensor, since the agent observes the state.
            kwargs["disturbances"] = Disturbances(stick_threshold=0.0, x_noise=0.0)
        elif disturbed:
            kwargs["disturbances"] = replace(disturbed, controls="both")
        slow = CapsuleEnv(**kwargs)
        # The same episode in steps of the law's period shows what each call of the law reads.
        kwargs["control_dt"] = self.options.control_dt / periods
        fast = CapsuleEnv(**kwargs)
        plant = chosen.plants[0]
        for env in (slow, fast):
            observation, _ = env.reset(seed=plant.seed, options=plant.reset_options())
        # The task's memory that the law observes is renewed at the end of an agent step alone.
        first = slow.simulation.layout.reference_end
        memory = slice(first, first + self.task.rows)
        renewed = slow.simulation.world[0, memory]
        observed = fast.simulation.world[0, memory]
        act = self.policy.start([plant.seed]) if self.policy else lambda _: np.zeros(1, np.float32)
        readings: list[dict[str, float]] = []
        actions: list[float] = []
        for _ in range(INTERVALS if self.policy else INTERVALS // 4):
            action = act(observation)
            actions.append(action.item())
            for _ in range(periods):
                readings.append(_read(fast.simulation))
                _, _, ended, _, _ = fast.step(action)
                observed[:] = renewed
                if ended:
                    return readings, actions
            observation, *_ = slow.step(action)
            observed[:] = renewed
        return readings, actions

    def _render(self, template: str, single: bool, **values: Any) -> str:
        """Fills a template, in which NAME is the prefix of all names, and REAL the number type."""
        try:
            from jinja2 import Environment, FileSystemLoader, StrictUndefined
        except ImportError as error:
            raise ImportError('--c needs jinja2: pip install "capsule-gym[export]"') from error
        environment = Environment(
            loader=FileSystemLoader(FOLDERS),
            keep_trailing_newline=True,
            trim_blocks=True,
            lstrip_blocks=True,
            undefined=StrictUndefined,
        )
        environment.filters["number"] = partial(c_number, single=single)
        environment.filters["table"] = partial(c_table, single=single)
        text = environment.get_template(template).render(vars(self) | values, single=single)
        text = text.replace("REAL", "float" if single else "double")
        text = text.replace("NAME", self.name).replace("THIS_FILE", str(values.get("file")))
        # The guard of a header: headers of one name with other contents do not skip each other.
        digest = hashlib.sha256(text.encode()).hexdigest()
        return text.replace("THIS_HASH", digest[:16])

    def onnx(self, *, single: bool = False) -> bytes:
        """The policy as an ONNX model, which computes in float or in double.

        Raises:
            ValueError: if there is no policy, but only a control law.
        """
        if self.policy is None:
            raise ValueError("--onnx needs a policy, got a control law")
        metadata = {
            "control_dt": self.options.control_dt,
            "torque_limit": self.options.torque_limit,
            "residual_limit": self.settings.residual_limit,
            "law": self.options.controller,
            "observation": list(self.observed),
        }
        return to_onnx(self.policy, self.scale, metadata, single=single)


def _read(simulation: Simulation) -> dict[str, float]:
    """What an exported policy reads of the single environment of a simulation."""
    column = simulation.columns(np.array([0]))[:, 0]
    prefix = "read_" if simulation.settings.agent_reads else ""
    reading = {name: column[getattr(Row, prefix + name)] for name in STATE}
    for name in ("law_torque", "M", "mu"):
        reading[name] = column[getattr(Row, name)]
    clock = column[Row.clock]
    reference = simulation.reference[int(clock)]
    reading |= dict(zip(("theta_d", "theta_d_dot"), reference, strict=False))
    reading |= dict(zip(simulation.task.fields, column[simulation.layout.task :], strict=False))
    reading["phase"] = clock / len(simulation.reference)
    return reading
