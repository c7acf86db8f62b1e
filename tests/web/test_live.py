"""The module for browsers in node: Python's bits, the module's interface, and its errors."""

import json
import re

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, Disturbances
from capsule_gym.envs.config import EnvConfig
from capsule_gym.evaluation.sets import SET_NAMES, load_set
from tests import ROOT
from tests.web.conftest import check_errors
from web import build, data, episodes

COMMITTED = episodes.committed_episodes()
PLANT = {"M": 0.5, "mu": 0.01}


def swing(env, steps):
    """Steps an environment as the function of this name in JavaScript."""
    for n in range(steps):
        env.step(np.array([0.02 * (n % 7 - 3)], np.float32))


def world_of(env):
    """The bits of the step's whole memory."""
    return env.simulation.world[0, :, 0].tobytes().hex()


@pytest.mark.parametrize("name", ["residual-real", "gait-predictive, disturbed"])
def test_committed_episodes_are_pythons(name):
    (committed,) = [episode for episode in COMMITTED if episode["name"] == name]
    assert episodes.compute(committed) == committed


FEW_PLANTS = 2
FEW_STEPS = 30


@pytest.fixture
def few_episodes(tmp_path, monkeypatch):
    """Two drivers without episodes, and short recordings, written to other files."""
    scripted = {name: episodes.ALL_SCRIPTED[name] for name in ("adaptive", "goal-pulses")}
    monkeypatch.setattr(episodes, "drivers", lambda: scripted)
    monkeypatch.setattr(episodes, "FILE", tmp_path / "episodes.json")
    monkeypatch.setattr(episodes, "RECORDINGS", tmp_path / "recordings.npz")
    monkeypatch.setattr(episodes, "RECORDED", ("dp-nominal",))
    monkeypatch.setattr(episodes, "SEEDS", FEW_PLANTS)
    monkeypatch.setattr(episodes, "EPISODE_STEPS", FEW_STEPS)
    episodes.FILE.write_text("[]", "utf-8")
    assert episodes.main(["--write"]) == 0


def test_written_episodes_are_equal(few_episodes):
    assert episodes.main([]) == 0


def test_every_driver_has_an_episode_on_a_set_of_its_task(few_episodes):
    written = episodes.committed_episodes()
    found = [(each["driver"], each["set"], each["plant"]) for each in written]
    assert found == [("adaptive", "drift", 0), ("goal-pulses", "goal", 1)]


def test_recordings_have_all_plants_of_every_set(few_episodes):
    recorded = np.load(episodes.RECORDINGS)
    assert list(recorded) == [f"dp-nominal {name}" for name in SET_NAMES]
    assert {actions.shape for actions in recorded.values()} == {(FEW_PLANTS, FEW_STEPS)}


def test_what_differs_is_printed(few_episodes, capsys):
    first, second = episodes.committed_episodes()
    first["steps"] = 3
    episodes.FILE.write_text(json.dumps([first, second]), "utf-8")
    recorded = dict(np.load(episodes.RECORDINGS))
    recorded["dp-nominal paper"] += 1
    np.savez_compressed(episodes.RECORDINGS, **recorded)
    assert episodes.main([]) == 1
    summary = f"{2 + len(recorded)} compared, 2 differ"
    printed = capsys.readouterr().out.splitlines()
    assert printed[-3:] == ["adaptive: differs", "dp-nominal paper: differs", summary]


def test_a_single_bit_fails_the_check(node, tmp_path, monkeypatch):
    episode = dict(COMMITTED[0])
    plant = load_set(episode.pop("set")).plants[episode.pop("plant")]
    episode |= data.describe_frozen(plant)
    del episode["seed"]
    episode["mu"] = float(np.nextafter(plant.mu, 1.0))
    monkeypatch.setattr(data, "committed_episodes", lambda: [episode])
    archive = data.pack_data(build.compile_wasm())
    module = tmp_path / "capsule.mjs"
    module.write_text(build.build_module(archive), "utf-8")
    assert node("show(await live.check());", module=module) is False


def test_the_history_reaches_back_to_a_latency_that_only_plants_draw(node):
    # Without disturbances in the options, but with a range of a constant and a latency.
    options = {
        "m_low": 0.13,
        "m_high": 0.14,
        "disturbances_latency_low": 0.1,
        "disturbances_latency_high": 0.1,
    }
    code = f"""
        const capsule = await live.load("direct", {{ options: {json.dumps(options)} }});
        const {{ settings, layout }} = capsule.description;
        capsule.reset({{ seed: 0 }});
        for (let n = 0; n < 60; n++) capsule.step(0.1);
        const delay = capsule.world[live.quantities.indexOf("delay")];
        show([delay, settings.history_states, (layout.estimator - layout.history) / 4]);
    """
    delay, states, kept = node(code)
    assert delay < states
    assert states == kept


@pytest.mark.parametrize("name", episodes.RECORDED)
@pytest.mark.parametrize(("set_name", "plant"), [("wide", 17), ("drift", 4)])
def test_recordings_are_what_the_policies_do(name, set_name, plant):
    recorded = np.load(episodes.RECORDINGS)[f"{name} {set_name}"]
    (actions,) = episodes.record_actions(name, [load_set(set_name).plants[plant]])
    assert actions.tolist() == recorded[plant].tolist()


def test_recordings_have_every_policy_on_every_set():
    keys = [f"{name} {set_name}" for name in episodes.RECORDED for set_name in SET_NAMES]
    assert list(np.load(episodes.RECORDINGS)) == keys


def test_a_restored_episode_goes_on_as_it_did(node):
    code = """
        const episode = await live.drive("residual-real", { changes: [{ t: 3, M: 0.4, mu: 0.1 }] });
        const run = (steps) => {
          for (let n = 0; n < steps; n++) episode.tick();
          return [bytes(episode.world), episode.action, episode.info.M];
        };
        run(100);
        const snapshot = episode.snapshot();
        const first = run(100);
        episode.restore(snapshot);
        const { steps } = episode.info;
        show([steps, first, run(100)]);
    """
    steps, first, again = node(code)
    assert steps == 100
    assert first[-1] == 0.4
    assert again == first


def test_an_episode_ends_as_pythons(node):
    env = CapsuleEnv()
    env.reset(options=PLANT)
    steps = 0
    terminated = False
    while not terminated:
        _, reward, terminated, _, info = env.step(np.ones(1, np.float32))
        steps += 1
    code = """
        const capsule = await live.load("direct");
        let last;
        do last = capsule.step(1); while (!last.terminated);
        const { steps, termination } = last.info;
        show([steps, last.reward, last.truncated, termination, capsule.metrics.mean_speed]);
    """
    termination = ["none", "pendulum", "contact", "diverged"][int(info["termination"])]
    speed = env.episode_metrics(1650)["mean_speed"]
    assert node(code) == [steps, reward, False, termination, speed]


# Fields of `Disturbances`, and resets: one that draws, and one that gives values.
DISTURBED = {
    "latency": (0.002, 0.011),
    "theta_noise": 0.01,
    "x_dot_bias": (-0.02, 0.02),
    "lag": 0.004,
    "push": 2.0,
    "theta_dot_resolution": 0.01,
    "jitter": (0.0, 0.003),
    "lost": 0.3,
    "hold": (0.0, 2.0),
    "x_dot_latency": 0.004,
    "unmeasured": ("theta_dot",),
    "controls": "agent",
}
SEED = 2**40 + 5
FIXED = {**PLANT, "capsule": {"slope": 0.02, "m": 0.14}, "disturbances": {"latency": 0.007}}


@pytest.fixture
def disturbed():
    """JavaScript that loads a disturbed `capsule`, and Python's environment."""
    code = (
        f'const capsule = await live.load("adaptive", {{ disturbances: {json.dumps(DISTURBED)} }});'
    )
    disturbances = Disturbances(**DISTURBED)
    return code, CapsuleEnv(controller="baselines:adaptive", disturbances=disturbances)


def test_disturbed_episodes_are_pythons(node, disturbed):
    loaded, env = disturbed
    worlds = []
    # The seed also determines the second episode.
    for seed, options in ((SEED, PLANT), (None, FIXED)):
        env.reset(seed=seed, options=options)
        swing(env, 80)
        worlds.append(world_of(env))
    code = f"""
        const worlds = [];
        for (const options of [{json.dumps({**PLANT, "seed": SEED})}, {json.dumps(FIXED)}]) {{
          capsule.reset(options);
          swing(capsule, 80);
          worlds.push(bytes(capsule.world));
        }}
        show(worlds);
    """
    assert node(loaded + code) == worlds


def test_info_shows_what_python_draws(node, disturbed):
    loaded, env = disturbed
    _, info = env.reset(seed=SEED)
    latency = info["disturbances"]["latency"]
    code = f"show(capsule.reset({{ seed: {SEED} }}).info.disturbances.latency);"
    assert 0.002 <= latency <= 0.011
    assert node(loaded + code) == latency


def test_info_shows_given_values_of_a_disturbed_plant(node, disturbed):
    loaded, _ = disturbed
    info = node(f"{loaded} show(capsule.reset({json.dumps(FIXED)}).info);")
    assert info["disturbances"]["latency"] == 0.007
    assert info["capsule"]["slope"] == 0.02
    assert list(info["reading"]) == ["theta", "theta_dot", "x", "x_dot"]


def test_a_latency_between_two_periods_is_accepted_up_to_its_end(node):
    given = {"latency": (0.0, 0.0409)}
    env = CapsuleEnv(disturbances=Disturbances(**given))
    plant = {**PLANT, "disturbances": {"latency": 0.0409}}
    env.reset(seed=7, options=plant)
    swing(env, 60)
    code = f"""
        const capsule = await live.load("direct", {{ disturbances: {json.dumps(given)} }});
        capsule.reset({json.dumps({**plant, "seed": 7})});
        swing(capsule, 60);
        const longer = {{ disturbances: {{ latency: 0.0421 }} }};
        show([bytes(capsule.world), await errorsOf([() => capsule.reset(longer)])]);
    """
    world, (error,) = node(code)
    limits = f"[0, {env.simulation.settings.longest_latency!r}]"
    accepted = f"a finite number in {limits}"
    assert world == world_of(env)
    assert error == f"RangeError: disturbances.latency must be {accepted}, got 0.0421"


COMMANDS = [{"t": 0.0, "v": 0.05}, {"t": 4.0, "v": -0.08}]
TASKS = [
    ("goal", {"goal": -0.07}, {"x_noise": 0.001}),
    ("velocity", {"commands": COMMANDS}, {"x_dot_bias": 0.02}),
]


@pytest.mark.parametrize(("task", "options", "disturbances"), TASKS)
def test_tasks_have_pythons_observations_and_metrics(node, task, options, disturbances):
    start = {"M": 0.5, "mu": 0.2, **options}
    controller = f"baselines:{task}_pulses"
    env = CapsuleEnv(task=task, controller=controller, disturbances=Disturbances(**disturbances))
    env.reset(seed=3, options=start)
    for _ in range(300):
        observation, _, _, _, info = env.step(np.zeros(1, np.float32))
    metrics = env.episode_metrics(None)
    given = json.dumps({**start, "seed": 3, "disturbances": disturbances})
    code = f"""
        const episode = await live.drive("{task}-pulses", {given});
        for (let n = 0; n < 300; n++) episode.tick();
        show([episode.task, bytes(episode.observation), episode.info.error, episode.metrics]);
    """
    *shown, found = node(code)
    assert shown == [task, observation.tobytes().hex(), float(info["error"])]
    finite = {name for name, value in metrics.items() if np.isfinite(value)}
    assert len(finite) >= 14
    for name in finite:
        assert found[name] == metrics[name], name


def test_the_command_prints_the_size_of_every_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(build, "compile_wasm", lambda: b"")
    monkeypatch.setattr(build, "pack_data", lambda module: "archive")
    build.main(["--output", str(tmp_path)])
    sizes = {path: path.stat().st_size for path in tmp_path.iterdir()}
    assert len(sizes) == 3
    printed = capsys.readouterr().out.splitlines()
    assert sorted(printed) == sorted(f"{path}: {size / 1e3:.0f} kB" for path, size in sizes.items())


def test_a_file_in_place_of_the_folder_is_named(tmp_path, refused):
    file = tmp_path / "live"
    file.touch()
    message = f"--output must be a folder that can be written to, got {str(file)!r}"
    assert message in refused(build.main, ["--output", str(file)])


def test_the_types_of_the_module_state_the_accepted_constants():
    types = (ROOT / "web/capsule.d.mts").read_text("utf-8")
    text = " ".join(types.replace("*", "").split())
    for name, (low, high) in data.describe_plant()["limits"].items():
        assert f"`{name}` {low:g} to {high:g}" in text


def test_an_integrator_must_be_stable_for_every_accepted_plant():
    # Of all accepted plants only those with friction of the motor need a shorter step.
    with pytest.raises(ValueError, match=r"physics_dt must be at most .*, got 0\.0028 s"):
        data.pack_options(EnvConfig(control_dt=0.028, physics_dt=0.0028))


def test_the_light_theme_defines_every_colour():
    style = build.build_style()
    light = style[: style.index("@media")]
    defined = re.findall(r"(--[\w-]+):", light)
    assert set(re.findall(r"var\((--[\w-]+)\)", style)) <= set(defined)


def test_types_declare_what_there_is(node):
    types = (ROOT / "web/capsule.d.mts").read_text("utf-8")
    declared = re.findall(r"^export (?:class|function|const) (\w+)", types, re.MULTILINE)
    assert sorted(declared) == node("show(Object.keys(live).sort());")


# Calls, and the errors that they raise.
WRONG_CALLS = {
    'live.load("sliding")':
        "RangeError: controller must be one of direct, adaptive,.*, got sliding",
    'live.load("direct", { disturbances: { lag: [2, 1] } })':
        "RangeError: disturbances.lag must be .* got 2,1",
    'live.load("direct", { disturbances: { lag: [] } })':
        "RangeError: disturbances.lag must be .* got $",
    'live.load("direct", { disturbances: { x_noise: -1 } })':
        r"RangeError: disturbances.x_noise must be .* in \[0, .*\], got -1",
    'live.load("direct", { disturbances: { stick_threshold: -1 } })':
        r"RangeError: disturbances.stick_threshold must be .* in \[0, .*\], got -1",
    'live.load("direct", { disturbances: { controls: "none" } })':
        "RangeError: disturbances.controls must be one of both, law, agent, got none",
    'live.load("direct", { disturbances: { unmeasured: ["x"] } })':
        "RangeError: disturbances.unmeasured must be an array out of theta, .*, got x",
    'live.load("direct", { set: "paper", task: "goal" })':
        "RangeError: task must be left out: the set says it",
    'live.drive("pd", { set: "goal", plant: 0 })':
        "RangeError: set must be one of the task speed, got goal",
    "capsule.reset({ seed: 1 })": "RangeError: seed must be left out: nothing is drawn",
    'live.drive("dp-oracle")': "RangeError: set and plant must be given: what dp-oracle does",
    'live.drive("epc", { set: "paper", plant: 100 })':
        "RangeError: plant must be .* 0 to 99, got 100",
    "capsule.reset({ M: 0 })": r"RangeError: M must be a finite number in \[0.2, 2\], got 0",
    "capsule.reset({ changes: [{ t: -1, M: 0.5, mu: 0 }] })":
        r"RangeError: changes\[0\].t must be .*, got -1",
    "capsule.step(NaN)": "RangeError: action must be a finite number, got NaN",
    "capsule.restore(other.snapshot())": "RangeError: snapshot must be one of",
    "ended.step(1)": r"Error: the episode has ended: reset\(\) first",
}  # fmt: skip


def test_bad_input_is_named(node):
    calls = ",\n".join(f"() => {call}" for call in WRONG_CALLS)
    script = f"""
        const capsule = await live.load("direct");
        const other = await live.load("epc");
        const ended = await live.load("direct");
        while (!ended.step(1).terminated);
        const before = bytes(capsule.world);
        show([await errorsOf([{calls}]), bytes(capsule.world) === before]);
    """
    errors, untouched = node(script)
    assert untouched
    check_errors(WRONG_CALLS, errors)


EXAMPLES = re.findall(
    r"^```js\n(.*?)^```", (ROOT / "docs/live.md").read_text("utf-8"), re.DOTALL | re.MULTILINE
)
IMPORT = re.compile(r'^import \{(.*)\} from "\./capsule\.mjs";\n', re.MULTILINE)


def test_the_documented_examples_run(node):
    assert EXAMPLES
    for example in EXAMPLES:
        body, imports = IMPORT.subn(r"const {\1} = live;\n", example)
        assert imports == 1
        expected = re.findall(r"console\.log\(.*\); // (.*)", body)
        code = f"""
            const lines = [];
            {{
              const console = {{ log: (...words) => lines.push(words.join(" ")) }};
              {body}
            }}
            show(lines);
        """
        assert node(code) == expected
