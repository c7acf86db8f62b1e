"""Every example runs, with a small budget, where its library is installed."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
ID = "capsule_gym:CapsuleStickSlip-v0"
# A checkout of CleanRL, which is no package.
CLEANRL = os.environ.get("CLEANRL", "")
ZOO = (
    "-m rl_zoo3.train --algo ppo --env CapsuleStickSlip-v0 --gym-packages capsule_gym --device cpu -n 4096 --conf-file"
)
# By the name of its extra: the module it needs, its command, and a word of what it prints at its end.
PROGRAMS = {
    "sb3": ("stable_baselines3", f"{EXAMPLES}/sb3_ppo.py --steps 8192", "return of an episode"),
    "sb3-contrib": ("sb3_contrib", f"{EXAMPLES}/sb3_contrib_tqc.py --steps 200", "total_timesteps"),
    "rl-zoo": ("rl_zoo3", f"{ZOO} {EXAMPLES}/rl_zoo.yml", "Saving to"),
    "rllib": ("ray.rllib", f"{EXAMPLES}/rllib_ppo.py --iterations 2 --batch 400", "steps, mean return -"),
    "skrl": ("skrl", f"{EXAMPLES}/skrl_ppo.py --steps 256", "256/256"),
    "tianshou": ("tianshou", f"{EXAMPLES}/tianshou_ppo.py --steps 64", "train_step=640"),
    "torchrl": ("torchrl", f"{EXAMPLES}/torchrl_envs.py --steps 50", "failures"),
    "minari": ("minari", f"{EXAMPLES}/minari_record.py --episodes 1", ""),
}
# SAC and TD3 read more of an episode that reaches its time limit, and begin with random torques whose seed CleanRL
# leaves to chance: few of those episodes end within 10 steps otherwise, and some last longer than the whole test.
SHORT = """
import gymnasium as gym

gym.register("Short-v0", entry_point="capsule_gym.env:CapsuleEnv", max_episode_steps=10)
"""
SCRIPTS = {
    "ppo_continuous_action": f"--env-id {ID} --total-timesteps 512 --num-steps 256",
    "sac_continuous_action": "--env-id short:Short-v0 --total-timesteps 300 --learning-starts 250",
    "td3_continuous_action": "--env-id short:Short-v0 --total-timesteps 300 --learning-starts 250",
}


def is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def run(command: str, folder: Path) -> str:
    """What the command prints, run as someone would who has installed the package."""
    environment = {
        **os.environ,
        "MINARI_DATASETS_PATH": str(folder),
        "OMP_NUM_THREADS": "1",
        "SDL_VIDEODRIVER": "dummy",
    }
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), environment.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, *command.split()], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    printed = done.stdout + done.stderr
    assert done.returncode == 0, printed[-3000:]
    return printed


@pytest.mark.parametrize("name", PROGRAMS)
def test_program_runs(name: str, tmp_path: Path) -> None:
    module, command, printed = PROGRAMS[name]
    if not is_installed(module):
        pytest.skip(f"{module} is not installed")
    assert printed in run(command, tmp_path)


@pytest.mark.parametrize("script", SCRIPTS)
def test_cleanrl_runs_as_it_is(script: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(CLEANRL, "cleanrl", f"{script}.py").resolve()
    if not path.is_file():
        pytest.skip("CLEANRL names no checkout of CleanRL")
    (tmp_path / "short.py").write_text(SHORT, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert "episodic_return=" in run(f"{EXAMPLES}/cleanrl_scripts.py {path} {SCRIPTS[script]}", tmp_path)


def test_every_program_is_short() -> None:
    lengths = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in EXAMPLES.glob("*_*.py")}
    del lengths["publish_data.py"]
    assert len(lengths) >= 8
    assert {name: length for name, length in lengths.items() if length >= 40} == {}


@pytest.mark.parametrize("name", ["README.md", "capsule_gym/env.py", "docs/works_with.md"])
def test_the_id_that_imports_the_package_is_told(name: str) -> None:
    assert ID in (ROOT / name).read_text(encoding="utf-8")
