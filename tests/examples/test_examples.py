"""Every example runs with a small budget if its library is installed (other than SB3's: if EXAMPLES is set)."""

import os
import re
import runpy
import shutil
import subprocess
import sys
import traceback
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
ID = "capsule_gym:CapsuleStickSlip-v0"
ZOO = "-m rl_zoo3.train --env CapsuleStickSlip-v0 --gym-packages capsule_gym --device cpu -n 4096"
PLAIN = f"{EXAMPLES}/plain_sb3.py --steps 2048 --every 2048"
# The required module, the command, and a pattern of what it prints at its end.
PROGRAMS = {
    "sb3": ("stable_baselines3", f"{EXAMPLES}/sb3_ppo.py --steps 2048", r"return of an episode: -?\d+\.\d \+- \d"),
    "sb3-her": ("stable_baselines3", f"{EXAMPLES}/sb3_her.py --steps 6528", r"before: distance .*\nafter: distance"),
    "sb3-direct": ("stable_baselines3", f"{PLAIN} direct", r"2,048 steps: -?\d+\.\d\d cm/s, \d+% failed"),
    "sb3-residual": ("stable_baselines3", f"{PLAIN} residual", r"2,048 steps: -?\d+\.\d\d cm/s, \d+% failed"),
    "rl-zoo": ("rl_zoo3", f"{ZOO} --algo ppo --conf-file {EXAMPLES}/rl_zoo.yml", "Saving to"),
    "rllib": ("ray.rllib", f"{EXAMPLES}/rllib_ppo.py --iterations 2 --batch 400", "steps, mean return -"),
    "skrl": ("skrl", f"{EXAMPLES}/skrl_ppo.py --steps 256", "256/256"),
    "tianshou": ("tianshou", f"{EXAMPLES}/tianshou_ppo.py --steps 64", "train_step=640"),
    "torchrl": ("torchrl", f"{EXAMPLES}/torchrl_envs.py --steps 50", "failures"),
    "optuna": ("optuna", f"{EXAMPLES}/optuna_ppo.py --trials 2 --steps 8192", r"best of 2 trials: a return of -?\d"),
    "minari": ("minari", f"{EXAMPLES}/offline_data.py --steps 2000", r"mixed: \d+ episodes, \d+ steps, mean return"),
}
# Episodes of 10 steps reach the time limit, of which SAC and TD3 read more; they begin with unseeded random torques.
SHORT = """
import gymnasium as gym

gym.register("Short-v0", entry_point="capsule_gym.env:CapsuleEnv", max_episode_steps=10)
"""
CLEANRL = {
    "ppo_continuous_action": f"--env-id {ID} --total-timesteps 512 --num-steps 256",
    "sac_continuous_action": "--env-id short:Short-v0 --total-timesteps 300 --learning-starts 250",
    "td3_continuous_action": "--env-id short:Short-v0 --total-timesteps 300 --learning-starts 250",
}


def run(command, folder):
    """Runs a command as a user with the installed package does, and returns its output."""
    variables = {"MINARI_DATASETS_PATH": str(folder), "OMP_NUM_THREADS": "1", "SDL_VIDEODRIVER": "dummy"}
    variables["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(folder)])
    command_line, environment = [sys.executable, *command.split()], {**os.environ, **variables}
    done = subprocess.run(command_line, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[-3000:]
    return done.stdout + done.stderr


@pytest.mark.parametrize("name", PROGRAMS)
def test_program_runs(name, tmp_path):
    module, command, printed = PROGRAMS[name]
    if module != "stable_baselines3" and "EXAMPLES" not in os.environ:
        pytest.skip("EXAMPLES is not set")
    pytest.importorskip(module)
    assert re.search(printed, run(command, tmp_path))


def test_skrl_records_the_last_observation_of_an_episode(monkeypatch):
    pytest.importorskip("skrl")
    from examples import skrl_ppo

    recorded = []
    monkeypatch.setattr(skrl_ppo.PPO, "record_transition", lambda agent, **transition: recorded.append(transition))
    batch = gym.make_vec(ID, num_envs=2, max_episode_steps=1, autoreset_mode="SAME_STEP")
    batch.reset(seed=0)
    observations, *_, infos = batch.step(batch.action_space.sample())
    agent = object.__new__(skrl_ppo.TimeLimitPPO)
    agent.record_transition(next_observations=skrl_ppo.torch.as_tensor(observations), infos=infos)
    assert np.array_equal(recorded[0]["next_observations"], np.stack(infos["final_obs"]))


@pytest.mark.parametrize("script", CLEANRL)
def test_cleanrl_runs_as_it_is(script, tmp_path):
    # CleanRL is a checkout, not a package.
    path = Path(os.environ.get("CLEANRL", ""), "cleanrl", f"{script}.py").resolve()
    if not path.is_file():
        pytest.skip("CLEANRL names no checkout of CleanRL")
    (tmp_path / "short.py").write_text(SHORT, encoding="utf-8")
    assert "episodic_return=" in run(f"{EXAMPLES}/cleanrl_scripts.py {path} {CLEANRL[script]}", tmp_path)


@pytest.mark.filterwarnings("default")
def test_d3rlpy_learns_from_the_data(tmp_path):
    if "EXAMPLES" not in os.environ:
        pytest.skip("EXAMPLES is not set")
    pytest.importorskip("d3rlpy")
    shutil.copytree(EXAMPLES / "data", tmp_path, dirs_exist_ok=True)
    assert "mixed, IQL: " in run(f"{EXAMPLES}/offline_rl.py --quality mixed --steps 10", tmp_path)


def replay(env, episode, seed):
    """Asserts that an episode is the one of its actions, bit for bit, and ends once."""
    start, _ = env.reset(seed=int(seed))
    seen, rewards, terminated, truncated, _ = zip(*map(env.step, episode.actions), strict=True)
    assert np.array_equal(episode.observations, [start, *seen]) and np.array_equal(episode.rewards, rewards)
    assert np.array_equal(episode.terminations, terminated) and np.array_equal(episode.truncations, truncated)
    assert np.add(terminated, truncated, dtype=int).tolist() == [0] * (len(seen) - 1) + [1]


@pytest.mark.parametrize("quality", ["random", "medium", "expert", "mixed"])
@pytest.mark.filterwarnings("default")
def test_the_data_are_the_episodes_of_their_actions(quality, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(EXAMPLES / "data"))
    dataset = minari.load_dataset(f"capsule/{quality}-v0")
    env = dataset.recover_environment()
    for episode, stored in zip(dataset, dataset.storage.get_episode_metadata(dataset.episode_indices), strict=True):
        replay(env, episode, stored["seed"])


@pytest.mark.filterwarnings("default")
def test_data_are_recorded_from_a_batch():
    pytest.importorskip("minari")
    from examples import offline_data

    for seed, episode in zip((5, 6), offline_data.episodes(offline_data.actor("random"), 5), strict=False):
        replay(gym.make(ID), episode, seed)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("[!c_]*.py")), ids=lambda path: path.stem)
def test_a_missing_library_is_named_with_its_extra(path, monkeypatch):
    for module in "d3rlpy minari optuna ray sb3_contrib skrl stable_baselines3 tianshou torchrl".split():
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError) as caught:
        runpy.run_path(str(path))
    (named,) = re.findall(r'# pip install -e "\.\[(\S+)\]"', "".join(traceback.format_exception(caught.value)))
    extras = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert all(f"\n{extra} = [" in extras for extra in named.split(","))
