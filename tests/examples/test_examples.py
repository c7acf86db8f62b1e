"""Every example runs with a small budget if its library is installed.

Libraries other than SB3 are tested if EXAMPLES is set.
"""

import os
import re
import runpy
import shutil
import subprocess
import sys
import traceback
from collections import namedtuple
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from capsule_gym import load_policy

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
ID = "capsule_gym:CapsuleStickSlip-v0"
ZOO = "-m rl_zoo3.train --env CapsuleStickSlip-v0 --gym-packages capsule_gym --device cpu -n 4096"
CURVE = r"2,048 steps: -?\d+\.\d\d cm/s, \d+% failed"
# By the name of an extra: the required module, the command, and a pattern of what it prints.
PROGRAMS = {
    "sb3": (
        "stable_baselines3",
        "sb3_ppo.py --steps 2048",
        r"return of an episode: -?\d+\.\d \+- \d",
    ),
    "sb3-her": (
        "stable_baselines3",
        "sb3_her.py --steps 6528",
        r"before: distance .*\nafter: distance",
    ),
    "sb3-direct": ("stable_baselines3", "plain_sb3.py --steps 2048 --every 2048 direct", CURVE),
    "sb3-residual": ("stable_baselines3", "plain_sb3.py --steps 2048 --every 2048 residual", CURVE),
    "rl-zoo": ("rl_zoo3", f"{ZOO} --algo ppo --conf-file {EXAMPLES}/rl_zoo.yml", "Saving to"),
    "rllib": ("ray.rllib", "rllib_ppo.py --iterations 2", "steps, mean return -"),
    "skrl": ("skrl", "skrl_ppo.py --steps 256", "256/256"),
    "tianshou": ("tianshou", "tianshou_ppo.py --steps 64", "train_step=20480"),
    "torchrl": ("torchrl", "torchrl_envs.py", "failures"),
    "optuna": (
        "optuna",
        "optuna_ppo.py --trials 2 --steps 8192",
        r"best of 2 trials: a return of -?\d",
    ),
    "minari": (
        "minari",
        "offline_data.py --steps 2000",
        r"mixed: \d+ episodes, \d+ steps, mean return",
    ),
}
# Episodes of 10 steps reach the time limit, of which SAC and TD3 read more; they begin with
# unseeded random torques.
SHORT = """
import gymnasium as gym
gym.register("Short-v0", "capsule_gym:CapsuleEnv", max_episode_steps=10)
"""
# Two environments, of which the first one ends.
OLD = """
import sys, gymnasium as gym, utils
def make(steps):
    env = gym.wrappers.RecordEpisodeStatistics(gym.make(sys.argv[1], max_episode_steps=steps))
    five = lambda observation: 0.0 * observation + utils.FIVE
    return lambda: gym.wrappers.TransformObservation(env, five)
envs = gym.vector.SyncVectorEnv([make(2), make(3)])
envs.reset(seed=0)
for _ in range(2):
    x, *_, info = envs.step(envs.action_space.sample())
    lengths = [last and int(last["episode"]["l"]) for last in info.get("final_info", [])]
    print(x.mean(), info.get("final_observation"), lengths)
"""
CLEANRL = {
    "ppo_continuous_action": f"--env-id {ID} --total-timesteps 512 --num-steps 256",
    "sac_continuous_action": "--env-id short:Short-v0 --total-timesteps 300 --learning-starts 250",
    "td3_continuous_action": "--env-id short:Short-v0 --total-timesteps 300 --learning-starts 250",
}


def run(command, folder):
    """Runs a command as a user with the installed package does, and returns its output."""
    environment = {
        **os.environ,
        "MINARI_DATASETS_PATH": str(folder),
        "OMP_NUM_THREADS": "1",
        "SDL_VIDEODRIVER": "dummy",
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(folder)]),
    }
    done = subprocess.run(
        [sys.executable, *command.split()],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    printed = done.stdout + done.stderr
    assert done.returncode == 0, printed[-3000:]
    return printed


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("name", PROGRAMS)
def test_program_runs(name, tmp_path, monkeypatch, capsys):
    module, command, printed = PROGRAMS[name]
    if module != "stable_baselines3" and "EXAMPLES" not in os.environ:
        pytest.skip("EXAMPLES is not set")
    pytest.importorskip(module)
    if module == "stable_baselines3":
        # The tests have imported it: another process would do so again.
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", command.split())
        runpy.run_path(str(EXAMPLES / sys.argv[0]), run_name="__main__")
        said = capsys.readouterr().out
    else:
        said = run(command if command.startswith("-m") else f"{EXAMPLES}/{command}", tmp_path)
    assert re.search(printed, said)


def test_skrl_records_the_last_observation_of_an_episode(monkeypatch):
    pytest.importorskip("skrl")
    from examples import skrl_ppo

    recorded = []

    def record(agent, *, next_observations, infos):
        recorded.append(next_observations)

    monkeypatch.setattr(skrl_ppo.PPO, "record_transition", record)
    batch = gym.make_vec(ID, num_envs=2, max_episode_steps=1, autoreset_mode="SAME_STEP")
    batch.reset(seed=0)
    observations, *_, infos = batch.step(batch.action_space.sample())
    agent = object.__new__(skrl_ppo.TimeLimitPPO)
    agent.record_transition(next_observations=skrl_ppo.torch.as_tensor(observations), infos=infos)
    assert_array_equal(recorded, [np.stack(infos["final_obs"])])


@pytest.mark.parametrize("script", CLEANRL)
def test_cleanrl_runs_as_it_is(script, tmp_path):
    # CleanRL is a checkout, not a package.
    path = Path(os.environ.get("CLEANRL", ""), "cleanrl", f"{script}.py").resolve()
    if not path.is_file():
        pytest.skip("CLEANRL names no checkout of CleanRL")
    (tmp_path / "short.py").write_text(SHORT, encoding="utf-8")
    command = f"{EXAMPLES}/cleanrl_scripts.py {path} {CLEANRL[script]}"
    assert "episodic_return=" in run(command, tmp_path)


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
    steps = [env.step(action) for action in episode.actions]
    seen, rewards, terminated, truncated, _ = zip(*steps, strict=True)
    assert_array_equal(episode.observations, [start, *seen])
    assert_array_equal(episode.rewards, rewards)
    assert_array_equal(episode.terminations, terminated)
    assert_array_equal(episode.truncations, truncated)
    ends = np.add(terminated, truncated, dtype=int)
    assert ends.tolist() == [0] * (len(steps) - 1) + [1]


@pytest.mark.parametrize("quality", ["random", "medium", "expert", "mixed"])
@pytest.mark.filterwarnings("default")
def test_the_data_are_the_episodes_of_their_actions(quality, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(EXAMPLES / "data"))
    dataset = minari.load_dataset(f"capsule/{quality}-v0")
    env = dataset.recover_environment()
    metadata = dataset.storage.get_episode_metadata(dataset.episode_indices)
    for episode, stored in zip(dataset, metadata, strict=True):
        replay(env, episode, stored["seed"])


@pytest.fixture
def record(monkeypatch):
    """Returns the episodes that `offline_data.write_dataset` records, without Minari."""
    made = []

    def create_dataset(name, buffers, **_):
        made.append(buffers)
        return SimpleNamespace(total_episodes=7, total_steps=8)

    fields = "id seed options observations actions rewards terminations truncations"
    library = SimpleNamespace(
        EpisodeBuffer=namedtuple("EpisodeBuffer", fields),
        create_dataset_from_buffers=create_dataset,
    )
    for name in ("minari", "minari.data_collector"):
        monkeypatch.setitem(sys.modules, name, library)
    from examples import offline_data

    # The second test finds the module imported.
    monkeypatch.setattr(offline_data, "minari", library)
    monkeypatch.setattr(offline_data, "BATCH", 3)

    def call(quality, steps):
        offline_data.write_dataset(quality, steps)
        return made.pop()

    return call


def test_data_are_recorded_in_their_qualities(record, capsys):
    *random, medium, expert = episodes = record("mixed", 4000)
    score = np.mean([episode.rewards.sum() for episode in episodes])
    said = f"mixed: 7 episodes, 8 steps, mean return {score:.1f} cm\n"
    assert capsys.readouterr().out == said
    seeds = [*range(10**6, 10**6 + len(random)), 10**6, 10**6]
    for episode, seed in zip(episodes, seeds, strict=True):
        assert episode.seed == seed
        replay(gym.make(ID), episode, seed)
    # The random ones are a third of the steps.
    drawn = np.concatenate([episode.actions for episode in random])
    assert len(drawn) - len(random[-1].actions) < 4000 / 3 <= len(drawn)
    assert np.abs(drawn).max() > 0.99
    assert drawn.std() == pytest.approx(3.0**-0.5, rel=0.05)
    assert_array_equal(expert.actions, load_policy("direct-ppo")(expert.observations[:-1]))
    chosen = load_policy("efficient")(medium.observations[:-1])
    noise = (medium.actions - chosen)[np.abs(chosen) < 0.1]
    assert noise.std() == pytest.approx(0.3, rel=0.1)
    assert np.abs(medium.actions).max() == 1.0


def test_data_of_one_quality_begin_with_the_first_seed(record):
    (episode,) = record("expert", 1)
    assert episode.seed == 0
    replay(gym.make(ID), episode, 0)


def test_sb3_sees_goals_ahead():
    from examples import sb3_her

    def assert_mirrored(found, expected, sign):
        # Not that of stick.
        signs = np.concatenate([sign, sign, sign, abs(sign), sign], axis=-1)
        assert_array_equal(found["observation"], expected["observation"] * signs)
        for name in ("achieved_goal", "desired_goal"):
            assert_array_equal(found[name], expected[name] * sign)
        assert found["desired_goal"][..., 0].min() > 0.0

    make = partial(sb3_her.CapsuleSB3VecEnv, 8, 0, max_episode_steps=3, **sb3_her.OPTIONS)
    plain = make()
    mirrored = sb3_her.GoalsAhead(make())
    action = np.linspace(-1.0, 1.0, 8, dtype=np.float32)[:, None]
    found = mirrored.reset()
    expected = plain.reset()
    for _ in range(4):
        sign = np.sign(expected["desired_goal"][:, :1])
        assert abs(sign.sum()) < 8
        assert_mirrored(found, expected, sign)
        found, rewards, dones, infos = mirrored.step(action)
        expected, plain_rewards, _, plain_infos = plain.step(action * sign)
        assert_array_equal(rewards, plain_rewards)
        for i in np.flatnonzero(dones):
            last = infos[i]["terminal_observation"]
            assert_mirrored(last, plain_infos[i]["terminal_observation"], sign[i])


def test_sb3_sees_the_distance_from_the_goal_at_three_scales():
    from examples import sb3_her

    env = sb3_her.GoalsAhead(sb3_her.CapsuleSB3VecEnv(8, 0, **sb3_her.OPTIONS))
    given = {name: sb3_her.torch.as_tensor(part) for name, part in env.reset().items()}
    coarse, middle, fine = sb3_her.Features(env.observation_space)(given)[:, -3:].T
    assert (coarse > 0.0).all()
    assert (coarse < middle).all()
    assert (middle <= fine).all()
    assert (fine <= 1.0).all()


def test_sb3_judges_episodes_by_their_ends():
    from examples import sb3_her

    def constant(action):
        return SimpleNamespace(predict=lambda *_, **__: (np.full((64, 1), action), None))

    batch = sb3_her.CapsuleSB3VecEnv(64, 10**6, **sb3_her.OPTIONS)
    mean = 100.0 * np.abs(batch.reset()["desired_goal"][:, 0]).mean()
    # The numbers of works_with.md.
    said = f"distance from the goal: median 30.2 cm, mean {mean:.1f} cm; 0% failed"
    assert sb3_her.evaluate(constant(0.0)) == said
    assert sb3_her.evaluate(constant(1.0)).endswith("; 100% failed")


LIBRARIES = "d3rlpy minari optuna ray sb3_contrib skrl stable_baselines3 tianshou torchrl".split()


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("[!c_]*.py")), ids=lambda path: path.stem)
def test_a_missing_library_is_named_with_its_extra(path, monkeypatch):
    for module in [*sys.modules, *LIBRARIES]:
        if module.partition(".")[0] in LIBRARIES:
            monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError) as caught:
        runpy.run_path(str(path))
    printed = "".join(traceback.format_exception(caught.value))
    (named,) = re.findall(r'# pip install -e "\.\[(\S+)\]"', printed)
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for extra in named.split(","):
        assert f"\n{extra} = [" in project
