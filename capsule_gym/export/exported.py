"""Exports a policy, and the control law that it acts on, as C99 or as an ONNX model.

The loops of the network are in `policy.h.jinja`; everything else is recorded from the core
(`c_code`).
"""

import re
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.lookup import find_controller
from capsule_gym.core import _core
from capsule_gym.core.layout import Row
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.env import CapsuleEnv
from capsule_gym.envs.simulation import Simulation
from capsule_gym.evaluation.sets import EPISODE_SETTINGS, load_set
from capsule_gym.export.c_code import c_number, c_table, to_c
from capsule_gym.parameters import Disturbances
from capsule_gym.policies.policy import load_policy
from capsule_gym.tasks.registry import find_task

# The templates, and the folder in which they find the operations in C that they share with the
# core.
FOLDERS = (Path(__file__).parent, Path(__file__).parents[1])
INTERVALS = 100  # control intervals of the test vectors; a law alone has a quarter


class Exported:
    """A policy or a control law with what its code needs.

    Args:
        name_or_path: as for `load_policy`; or the import string of a control law, such as
            "baselines:adaptive".
        law: whether the policy's control law is exported, too.

    Raises:
        TypeError: if the import string names something else.
        ValueError: if there is no such policy or law, or the law is not part of the core.
    """

    def __init__(self, name_or_path: str, law: bool = False) -> None:
        alone = re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*", name_or_path) is not None
        self.policy = None if alone else load_policy(name_or_path)
        own = find_controller(name_or_path) if alone else None
        task = "speed" if own is None or own.task is None else find_task(own.task).name
        self.env_kwargs = (
            self.policy.env_kwargs if self.policy else {"controller": name_or_path, "task": task}
        )
        self.name = re.sub(
            r"\W|^(?=\d)", "_", self.policy.name if self.policy else name_or_path.partition(":")[2]
        )
        self.options = EnvConfig(**self.env_kwargs)
        self.controller = own or find_controller(self.options.controller)
        self.law = self.controller if law or alone else None
        if (law or alone) and not isinstance(getattr(self.controller, "law", None), CoreLaw):
            found = self.options.controller or "a policy without a control law"
            raise ValueError(
                f"--law needs a control law of the core, such as baselines:adaptive, got {found}"
            )
        simulation = Simulation(1, self.options)
        self.task = simulation.task
        self.settings = simulation.settings
        self.layout = simulation.layout
        self.constants = simulation.fields["settings"]
        self.entries = [
            f"observation[{n}]" for n in range(len(simulation.entries) // self.options.stack_size)
        ]
        self.reading = ["theta", "theta_dot", "x", "x_dot", "action"]
        self.reading += ["theta_d", "theta_d_dot", "phase", "law_torque"] if self.controller else []
        self.reading += ["M", "mu"] if self.options.observe_parameters else []
        self.reading += {"goal": ["goal"], "velocity": ["command"]}.get(self.task.name, [])
        if self.policy:
            self.scale = 1.0 / np.sqrt(self.policy.variance + self.policy.epsilon)

    def c(self, *, single: bool = False) -> str:
        """The C99 header, which computes in float or in double; in double it has the bits of this
        package.
        """
        task, law = self.task, self.law
        # The task's memory but for what an episode draws. Goal and command are given; a new command
        # ends the last one.
        kept = task.rows - sum(task.option_sizes.values())
        given = dict.fromkeys(task.fields[kept:], "0") | dict.fromkeys(
            ("v_0", "v_1"), "reading->command"
        )
        given |= {"goal": "reading->goal", "displacement": "(reading->goal - reading->x)"}
        given |= {"lasts": "(reading->command == before.task[0] ? HUGE_VAL : 0)"}
        task_inputs = [given.get(name, f"before.task[{n}]") for n, name in enumerate(task.fields)]
        observed = [*task_inputs, "reading->x", "before.x", "before.begun"]
        observed += [f"reading->{name}" if name in self.reading else "0" for name in _core.OBSERVED]
        filtered = [f"estimates[{n}]" for n in range(_core.ESTIMATOR_CELLS)]
        estimates = [f"memory->{cell}" for cell in filtered]
        law_cells = [f"law[{n}]" for n in range(len(law.memory) if law else 0)]
        memory = {
            "task": kept,
            "estimates": len(filtered) * bool(self.settings.with_estimates),
            "law": len(law_cells),
        }
        law_inputs = [f"before.{cell}" for cell in law_cells]
        law_inputs += [f"reading->{name}" for name in ("theta", "theta_dot", "x", "x_dot")]
        law_inputs += [f"row[{n}]" for n in range(law.reference.shape[1] if law else 0)]
        return self._render(
            "policy.h.jinja",
            single,
            code=partial(to_c, single=single),
            memory=[*(f"{name}[{size}]" for name, size in memory.items() if size), "x"],
            task_inputs=task_inputs,
            task_outputs=[f"memory->task[{n}]" if n < kept else None for n in range(task.rows)],
            observed=observed + estimates,
            filter_inputs=[
                *(f"before.{cell}" for cell in filtered),
                *(f"(REAL)observation[{n}]" for n in range(3)),
            ],
            estimates=estimates,
            law_inputs=law_inputs + (task_inputs if law and law.task else []),
            law_outputs=["torque", *(f"memory->{cell}" for cell in law_cells)],
            widest=max([len(self.policy.mean), *(len(bias) for _, bias in self.policy.layers)])
            if self.policy
            else 0,
            description=self.policy.description
            if self.policy
            else f"control law {self.options.controller}",
            version=version("capsule-gym"),
        )

    def c_test(self, file: str, *, single: bool = False) -> str:
        """A C99 program that checks the header `file` on the first episode of an evaluation set."""
        disturbed = Disturbances.named(self.options.disturbances)
        chosen = load_set(
            "real" if disturbed else {"speed": "paper"}.get(self.task.name, self.task.name)
        )
        plant = chosen.plants[0]
        kwargs = {**chosen.env_kwargs, **self.env_kwargs, **EPISODE_SETTINGS}
        if disturbed:
            # An exact sensor where the agent observes the state: the header has one reading for
            # agent and law.
            exact = Disturbances(stick_threshold=0.0, x_noise=0.0)
            kwargs["disturbances"] = (
                exact if disturbed.controls == "law" else replace(disturbed, controls="both")
            )
        # The same episode in steps of the law's period shows what each call of the law reads.
        periods = int(self.settings.law_steps) if self.law else 1
        slow = CapsuleEnv(**kwargs)
        fast = CapsuleEnv(**{**kwargs, "control_dt": self.options.control_dt / periods})
        for env in (slow, fast):
            observation, _ = env.reset(seed=plant.seed, options=plant.reset_options())
        # The task's memory that the law observes is renewed at the end of an agent step alone.
        simulation = slow.simulation
        first = simulation.layout.reference_end
        ours, observed = (
            env.simulation.world[0, first : first + self.task.rows] for env in (fast, slow)
        )
        act = self.policy or (lambda _: np.zeros(1, np.float32))
        computed = (
            "action",
            *(("theta_d", "theta_d_dot", "phase", "law_torque") if self.law else ()),
        )
        columns = [name for name in self.reading if name not in computed]
        shown, actions = list[dict[str, float]](), list[float]()
        for _ in range(INTERVALS if self.policy else INTERVALS // 4):
            action = act(observation)
            actions.append(float(action[0]))
            for _ in range(periods):
                shown.append(_read(fast.simulation))
                _, _, ended, _, _ = fast.step(action)
                ours[:] = observed
                if ended:
                    break
            if ended:
                break
            observation, *_ = slow.step(action)
            ours[:] = observed
        return self._render(
            "policy_test.c.jinja",
            single,
            file=file,
            set=chosen.name,
            columns=columns,
            given=np.array([[each[name] for name in columns] for each in shown]),
            actions=actions,
            torques=[each["law_torque"] for each in shown],
            periods=periods,
            tolerance=1e-3 if self.settings.with_estimates else 2e-5,
        )

    def _render(self, template: str, single: bool, **values: Any) -> str:
        """Fills a template; NAME stands for the prefix of all names, REAL for the type of the
        numbers.
        """
        try:
            from jinja2 import Environment, FileSystemLoader, StrictUndefined
        except ImportError as error:
            raise ImportError('--c needs jinja2: pip install "capsule-gym[export]"') from error
        options: dict[str, Any] = {
            "trim_blocks": True,
            "lstrip_blocks": True,
            "undefined": StrictUndefined,
        }
        environment = Environment(
            loader=FileSystemLoader(FOLDERS), keep_trailing_newline=True, **options
        )
        environment.filters |= {
            "number": partial(c_number, single=single),
            "table": partial(c_table, single=single),
        }
        text: str = environment.get_template(template).render(
            {**vars(self), **values, "single": single}
        )
        text = text.replace("REAL", "float" if single else "double").replace("NAME", self.name)
        return text.replace("THIS_FILE", str(values.get("file")))

    def onnx(self, *, single: bool = False) -> bytes:
        """The policy as an ONNX model, which computes in float or in double.

        Raises:
            ValueError: if there is no policy, but only a control law.
        """
        if self.policy is None:
            raise ValueError("--onnx needs a policy, got a control law")
        try:
            from onnx import TensorProto, checker, helper, numpy_helper
        except ImportError as error:
            raise ImportError('--onnx needs onnx: pip install "capsule-gym[export]"') from error
        policy = self.policy
        real: Any = np.float32 if single else np.float64
        # Policies that end with tanh are steep: they amplify rounding errors before the last layer
        # up to 80 times.
        hidden: Any = np.float64 if policy.squashing == "tanh" else real
        *layers, last = policy.layers
        # Each operation takes the result of the last one, and constants.
        chain: list[Any] = [
            ("Cast", hidden),
            ("Sub", hidden, policy.mean),
            ("Mul", hidden, self.scale),
        ]
        chain.append(("Clip", hidden, -policy.clip, policy.clip))
        for layer in layers:
            chain += [("Gemm", hidden, *layer), (policy.activation.capitalize(), hidden)]
        chain += [("Cast", real), ("Gemm", real, *last)]
        chain += [] if policy.squashing == "clip" else [(policy.squashing.capitalize(), real)]
        chain += [("Clip", real, -1.0, 1.0), ("Cast", np.float32)]
        names = ["observation", *(f"value_{n}" for n in range(1, len(chain))), "action"]
        nodes, initializers = list[Any](), list[Any]()
        for n, (operation, dtype, *constants) in enumerate(chain):
            own = [f"constant_{n}_{k}" for k in range(len(constants))]
            initializers += map(
                numpy_helper.from_array, (np.asarray(each, dtype) for each in constants), own
            )
            options: Any = {
                "Cast": {"to": helper.np_dtype_to_tensor_dtype(np.dtype(dtype))},
                "Gemm": {"transB": 1},
            }
            nodes.append(
                helper.make_node(
                    operation, [names[n], *own], [names[n + 1]], **options.get(operation, {})
                )
            )
        tensor = partial(helper.make_tensor_value_info, elem_type=TensorProto.FLOAT)
        inputs, outputs = (
            [tensor("observation", shape=["n", policy.entries])],
            [tensor("action", shape=["n", 1])],
        )
        graph = helper.make_graph(
            nodes, policy.name, inputs, outputs, initializers, doc_string=policy.description
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        checker.check_model(model)
        return model.SerializeToString()


def _read(simulation: Simulation) -> dict[str, float]:
    """What an exported policy reads of the single environment of a simulation."""
    read = "read_" if simulation.settings.agent_reads else ""
    column = simulation.columns(np.array([0]))[:, 0]
    shown = {
        name: column[getattr(Row, read + name)] for name in ("theta", "theta_dot", "x", "x_dot")
    }
    shown |= {name: column[getattr(Row, name)] for name in ("law_torque", "M", "mu")}
    clock = column[Row.clock]
    shown |= dict(zip(("theta_d", "theta_d_dot"), simulation.reference[int(clock)], strict=False))
    shown |= dict(zip(simulation.task.fields, column[simulation.layout.task :], strict=False))
    return {**shown, "phase": clock / len(simulation.reference)}
