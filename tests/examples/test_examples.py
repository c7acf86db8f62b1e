"""Every example runs with a small budget if its library is installed (other than SB3's: if EXAMPLES
is set)."""

import os
import re
import runpy
import shutil
import subprocess
import sys
import traceback
from collections import namedtuple
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from capsule_gym import load_policy

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
ID = "capsule_gym:CapsuleStickSlip-v0"
ZOO = "-m rl_zoo3.train --env CapsuleStickSlip-v0 --gym-packages capsule_gym --device cpu -n 4096"
PLAIN = f"{EXAMPLES}/plain_sb3.py --steps 2048 --every 2048"
# The required module, the command, and a pattern of what it prints at its end.
PROGRAMS = {
    "sb3": (
        "stable_baselines3",
        f"{EXAMPLES}/sb3_ppo.py --steps 2048",
        r"return of an episode: -?\d+\.\d \+- \d",
    ),
    "sb3-her": (
        "stable_baselines3",
        f"{EXAMPLES}/sb3_her.py --steps 6528",
        r"before: distance .*\nafter: distance",
    ),
    "sb3-direct": (
        "stable_baselines3",
        f"{PLAIN} direct",
        r"2,048 steps: -?\d+\.\d\d cm/s, \d+% failed",
    ),
    "sb3-residual": (
        "stable_baselines3",
        f"{PLAIN} residual",
        r"2,048 steps: -?\d+\.\d\d cm/s, \d+% failed",
    ),
    "rl-zoo": ("rl_zoo3", f"{ZOO} --algo ppo --conf-file {EXAMPLES}/rl_zoo.yml", "Saving to"),
    "rllib": ("ray.rllib", f"{EXAMPLES}/rllib_ppo.py --iterations 2", "steps, mean return -"),
    "skrl": ("skrl", f"{EXAMPLES}/skrl_ppo.py --steps 256", "256/256"),
    "tianshou": ("tianshou", f"{EXAMPLES}/tianshou_ppo.py --steps 64", "train_step=20480"),
    "torchrl": ("torchrl", f"{EXAMPLES}/torchrl_envs.py", "failures"),
    "optuna": (
        "optuna",
        f"{EXAMPLES}/optuna_ppo.py --trials 2 --steps 8192",
        r"best of 2 trials: a return of -?\d",
    ),
    "minari": (
        "minari",
        f"{EXAMPLES}/offline_data.py --steps 2000",
        r"mixed: \d+ episodes, \d+ steps, mean return",
    ),
}
# Episodes of 10 steps reach the time limit, of which SAC and TD3 read more; they begin with
# unseeded random torques.
SHORT = "import gymnasium as gym\ngym.register('Short-v0', 'capsule_gym:CapsuleEnv', max_episode_steps=10)"
# Two environments, of which the first one ends.
OLD = """
import sys, gymnasium as gym, utils
def make(steps):
    env = gym.wrappers.RecordEpisodeStatistics(gym.make(sys.argv[1], max_episode_steps=steps))
    return lambda: gym.wrappers.TransformObservation(env, lambda observation: 0.0 * observation + utils.FIVE)
envs = gym.vector.SyncVectorEnv([make(2), make(3)])
envs.reset(seed=0)
for _ in range(2):
    x, *_, info = envs.step(envs.action_space.sample())
    print(x.mean(), info.get("final_observation"), [e and int(e["episode"]["l"]) for e in info.get("final_info", [])])
"""
CLEANRL = {
    "ppo_continuous_action": f"--env-id {ID} --total-timesteps 512 --num-steps 256",
    "sac_continuous_action": "--env-id short:Short-v0 --total-timesteps 300 --learning-starts 250",
    "td3_continuous_action": "--env-id short:Short-v0 --total-timesteps 300 --learning-starts 250",
}


def run(command, folder):
    """Runs a command as a user with the installed package does, and returns its output."""
    variables = {
        "MINARI_DATASETS_PATH": str(folder),
        "OMP_NUM_THREADS": "1",
        "SDL_VIDEODRIVER": "dummy",
    }
    variables["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(folder)])
    command_line, environment = [sys.executable, *command.split()], {**os.environ, **variables}
    done = subprocess.run(
        command_line, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
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
    monkeypatch.setattr(
        skrl_ppo.PPO, "record_transition", lambda agent, **transition: recorded.append(transition)
    )
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
    assert "episodic_return=" in run(
        f"{EXAMPLES}/cleanrl_scripts.py {path} {CLEANRL[script]}", tmp_path
    )


def test_cleanrl_scripts_read_the_ends_of_gymnasium_0_29(tmp_path):
    (tmp_path / "old/scripts").mkdir(parents=True)
    (tmp_path / "old/scripts/script.py").write_text(OLD)
    (tmp_path / "old/utils.py").write_text("FIVE = 5.0")
    said = "5.0 None []\n5.0 [array([5., 5., 5., 5., 5.], dtype=float32) None] [2, None]\n"
    assert run(f"{EXAMPLES}/cleanrl_scripts.py old/scripts/script.py {ID}", tmp_path) == said


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
    assert np.array_equal(episode.observations, [start, *seen]) and np.array_equal(
        episode.rewards, rewards
    )
    assert np.array_equal(episode.terminations, terminated) and np.array_equal(
        episode.truncations, truncated
    )
    assert np.add(terminated, truncated, dtype=int).tolist() == [0] * (len(seen) - 1) + [1]


@pytest.mark.parametrize("quality", ["random", "medium", "expert", "mixed"])
@pytest.mark.filterwarnings("default")
def test_the_data_are_the_episodes_of_their_actions(quality, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(EXAMPLES / "data"))
    dataset = minari.load_dataset(f"capsule/{quality}-v0")
    env = dataset.recover_environment()
    for episode, stored in zip(
        dataset, dataset.storage.get_episode_metadata(dataset.episode_indices), strict=True
    ):
        replay(env, episode, stored["seed"])


def test_data_are_recorded_in_their_qualities(monkeypatch, capsys):
    made, total = [], SimpleNamespace(total_episodes=7, total_steps=8)
    fields = "id seed options observations actions rewards terminations truncations"
    library = SimpleNamespace(EpisodeBuffer=namedtuple("EpisodeBuffer", fields))
    library.create_dataset_from_buffers = lambda name, buffers, **_: made.append(buffers) or total
    [
        monkeypatch.setitem(sys.modules, name, library)
        for name in ("minari", "minari.data_collector")
    ]
    from examples import offline_data

    monkeypatch.setattr(offline_data, "BATCH", 3)
    offline_data.write_dataset("mixed", 4000)
    offline_data.write_dataset("expert", 1)
    ((*random, medium, expert), (first,)), env = made, gym.make(ID)
    said = f"mixed: 7 episodes, 8 steps, mean return {np.mean([each.rewards.sum() for each in made[0]]):.1f} cm\n"
    assert capsys.readouterr().out.startswith(said)
    seeds = [*range(10**6, 10**6 + len(random)), 10**6, 10**6, 0]
    for each, seed in zip((*random, medium, expert, first), seeds, strict=True):
        replay(env, each, seed)
        assert each.seed == seed
    drawn = np.concatenate([each.actions for each in random])
    assert len(drawn) - len(random[-1].actions) < 4000 / 3 <= len(drawn)
    assert np.abs(drawn).max() > 0.99 and drawn.std() == pytest.approx(3.0**-0.5, rel=0.05)
    assert np.array_equal(expert.actions, load_policy("direct-ppo")(expert.observations[:-1]))
    chosen = load_policy("efficient")(medium.observations[:-1])
    noise = (medium.actions - chosen)[np.abs(chosen) < 0.1]
    assert noise.std() == pytest.approx(0.3, rel=0.1) and np.abs(medium.actions).max() == 1.0


def test_sb3_sees_goals_ahead_and_judges_episodes_by_their_ends():
    from examples import sb3_her

    def assert_mirrored(found, expected, sign):
        signs = {
            "observation": np.concatenate([sign] * 3 + [abs(sign), sign], axis=-1)
        }  # not that of stick
        assert all(
            np.array_equal(part, expected[name] * signs.get(name, sign))
            for name, part in found.items()
        )
        assert found["desired_goal"][..., 0].min() > 0.0

    plain, mirrored = (
        sb3_her.CapsuleSB3VecEnv(8, 0, max_episode_steps=3, **sb3_her.OPTIONS) for _ in range(2)
    )
    mirrored, action = (
        sb3_her.GoalsAhead(mirrored),
        np.linspace(-1.0, 1.0, 8, dtype=np.float32)[:, None],
    )
    found, expected = mirrored.reset(), plain.reset()
    for _ in range(4):
        assert_mirrored(found, expected, sign := np.sign(expected["desired_goal"][:, :1]))
        (found, rewards, dones, infos), (expected, same, _, ends) = (
            mirrored.step(action),
            plain.step(action * sign),
        )
        assert np.array_equal(rewards, same) and abs(sign.sum()) < 8
        for i in np.flatnonzero(dones):
            assert_mirrored(*(each[i]["terminal_observation"] for each in (infos, ends)), sign[i])
    given = {name: sb3_her.torch.as_tensor(part) for name, part in found.items()}
    coarse, middle, fine = sb3_her.Features(mirrored.observation_space)(given)[:, -3:].T
    assert (
        (0.0 < coarse).all()
        and (coarse < middle).all()
        and (middle <= fine).all()
        and (fine <= 1.0).all()
    )
    goals = np.abs(
        sb3_her.CapsuleSB3VecEnv(64, 10**6, **sb3_her.OPTIONS).reset()["desired_goal"][:, 0]
    )
    still, wild = (
        SimpleNamespace(predict=lambda *_, a=a, **__: (np.full((64, 1), a), None))
        for a in (0.0, 1.0)
    )
    said = f"distance from the goal: median 30.2 cm, mean {100.0 * goals.mean():.1f} cm; 0% failed"  # works_with.md
    assert sb3_her.evaluate(still) == said and sb3_her.evaluate(wild).endswith("; 100% failed")


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("[!c_]*.py")), ids=lambda path: path.stem)
def test_a_missing_library_is_named_with_its_extra(path, monkeypatch):
    libraries = (
        "d3rlpy minari optuna ray sb3_contrib skrl stable_baselines3 tianshou torchrl".split()
    )
    for module in (
        name for name in [*sys.modules, *libraries] if name.partition(".")[0] in libraries
    ):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError) as caught:
        runpy.run_path(str(path))
    (named,) = re.findall(
        r'# pip install -e "\.\[(\S+)\]"', "".join(traceback.format_exception(caught.value))
    )
    extras = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert all(f"\n{extra} = [" in extras for extra in named.split(","))
