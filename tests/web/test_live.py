"""The module for browsers in node: Python's bits, the module's interface, and its errors."""

import json
import os
import re
import shutil
import subprocess

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, Disturbances, load_policy
from capsule_gym.evaluation.sets import SET_NAMES, load_set
from tests import ROOT
from web import build, data, episodes

COMMITTED = json.loads(episodes.FILE.read_text(encoding="utf-8"))
TASKS = [("goal", {"goal": -0.07}, {"x_noise": 0.001})]
TASKS += [("velocity", {"commands": [{"t": 0.0, "v": 0.05}, {"t": 4.0, "v": -0.08}]}, {"x_dot_bias": 0.02})]


@pytest.fixture(scope="session")
def node(site):
    """Runs JavaScript with the module as `live`, and returns the value passed to `show`."""
    # Optional on a user's machine, and required in CI.
    if shutil.which("node") is None and "CI" not in os.environ:
        pytest.skip("needs node")

    def run(code, *arguments, module=site / "capsule.mjs"):
        script = (
            f"import * as live from {json.dumps(module.as_uri())};\n"
            "let shown = null;\nconst show = (value) => (shown = value);\n"
            "const bytes = (array) => Buffer.from(array.buffer, array.byteOffset, array.byteLength).toString('hex');\n"
            f"{code}\nconsole.log(JSON.stringify(shown));\n"
        )
        command = ["node", "--input-type=module", "--eval", script, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return run


@pytest.mark.parametrize("name", ["residual-real", "gait-predictive, disturbed"])
def test_committed_episodes_are_pythons(name):
    committed = next(episode for episode in COMMITTED if episode["name"] == name)
    assert episodes.compute(committed) == committed


def test_episodes_are_written_and_compared(tmp_path, monkeypatch, capsys):
    names = ("adaptive", "goal-pulses")
    for name, value in {
        "FILE": tmp_path / "episodes.json", "RECORDINGS": tmp_path / "recordings.npz", "SEEDS": 2, "EPISODE_STEPS": 30,
        "RECORDED": ("dp-nominal",), "drivers": lambda: {each: episodes.ALL_SCRIPTED[each] for each in names},
    }.items():  # fmt: skip
        monkeypatch.setattr(episodes, name, value)
    episodes.FILE.write_text("[]", encoding="utf-8")
    assert episodes.main(["--write"]) == episodes.main([]) == 0
    written = json.loads(episodes.FILE.read_text(encoding="utf-8"))
    found = [(each["driver"], each["set"], each["plant"]) for each in written]
    assert found == [(names[0], "drift", 0), (names[1], "goal", 1)]
    recorded = dict(np.load(episodes.RECORDINGS))
    assert {each.shape for each in recorded.values()} == {(2, 30)} and "dp-nominal paper" in recorded
    np.savez_compressed(episodes.RECORDINGS, **{**recorded, "dp-nominal paper": recorded["dp-nominal paper"] + 1})
    episodes.FILE.write_text(json.dumps([{**written[0], "steps": 3}, written[1]]), encoding="utf-8")
    assert episodes.main([]) == 1
    assert capsys.readouterr().out.splitlines()[-3:] == [
        "adaptive: differs", "dp-nominal paper: differs", f"{2 + len(recorded)} compared, 2 differ"
    ]  # fmt: skip


def test_a_single_bit_fails_the_check(node, tmp_path, monkeypatch):
    committed = {key: value for key, value in COMMITTED[0].items() if key not in ("set", "plant")}
    plant = data.describe_set(load_set(COMMITTED[0]["set"]))["plants"][COMMITTED[0]["plant"]]
    del plant["seed"]
    altered = [{**committed, **plant, "mu": float(np.nextafter(plant["mu"], 1.0))}]
    monkeypatch.setattr(data, "FILE", tmp_path / "episodes.json")
    data.FILE.write_text(json.dumps(altered), encoding="utf-8")
    module = tmp_path / "capsule.mjs"
    module.write_text(build.build_module(data.pack_data(build.compile_wasm())), encoding="utf-8")
    assert node("show(await live.check());", module=module) is False


def test_a_policy_of_ones_own_gives_the_bits_of_the_one_that_came_with_the_module(node, tmp_path):
    described = data.describe_policy("mine", load_policy("residual-ppo"))
    (tmp_path / "mine.json").write_text(json.dumps({**described, "network": described["network"].tolist()}), "utf-8")
    code = """
        import { readFileSync } from "node:fs";
        const mine = JSON.parse(readFileSync(process.argv[1]));
        live.addDriver(mine);
        const worlds = [];
        for (const name of ["residual-ppo", "mine"]) {
          const episode = await live.drive(name, { M: 0.6, mu: 0.02 });
          for (let n = 0; n < 60; n++) episode.tick();
          worlds.push(bytes(episode.world));
        }
        const refused = [];
        const attempts = [{}, { name: 1 }, { name: "a", task: "moon" }, { name: "a", settings: { ideal: [] } }];
        attempts.push({ name: "a", settings: { ...mine.settings, entries: 9 } });
        attempts.push(...[mine.network.slice(8), [1], [NaN]].map((network) => ({ name: "a", network })));
        for (const wrong of attempts) {
          try { live.addDriver({ ...mine, ...wrong }); } catch (error) { refused.push(error.message); }
        }
        show([worlds, live.drivers.at(-1), refused]);
    """
    (own, shown, refused) = node(code, str(tmp_path / "mine.json"))
    assert own[0] == own[1] and "network" not in shown
    assert shown["name"] == "mine" and shown["controlDt"] == described["settings"]["control_dt"]
    words = ["got mine", "must be a string, got 1", "got moon", "settings.ideal must be", "for 9 entries, got"]
    words += ["for 10 entries, got", "for 10 entries, got 1", "network[0]"]
    assert all(word in message for message, word in zip(refused, words, strict=True)), refused


@pytest.mark.parametrize("name", episodes.RECORDED)
def test_recordings_are_what_the_policies_do(name):
    known = np.load(episodes.RECORDINGS)
    assert [key for key in known if key.startswith(name)] == [f"{name} {each}" for each in SET_NAMES]
    for each, n in (("wide", 17), ("drift", 4)):
        actions = episodes.record_actions(name, [load_set(each).plants[n]])
        assert actions[0].tolist() == known[f"{name} {each}"][n].tolist()


def test_a_restored_episode_goes_on_as_it_did(node):
    code = """
        const episode = await live.drive("residual-real", { changes: [{ t: 3, M: 0.4, mu: 0.1 }] });
        const run = (steps) => { for (let n = 0; n < steps; n++) episode.tick(); return bytes(episode.world); };
        run(100);
        const snapshot = episode.snapshot();
        const [first, action] = [run(100), episode.action];
        episode.restore(snapshot);
        const back = episode.info.steps;
        show([back, first === run(100), action === episode.action, episode.info.M]);
    """
    assert node(code) == [100, True, True, 0.4]


def test_an_episode_ends_as_pythons(node):
    env = CapsuleEnv()
    env.reset(options={"M": 0.5, "mu": 0.01})
    steps, terminated = 0, False
    while not terminated:
        _, reward, terminated, _, info = env.step(np.ones(1, np.float32))
        steps += 1
    code = """
        const capsule = await live.load("direct");
        let last;
        do last = capsule.step(1); while (!last.terminated);
        let message = "";
        try { capsule.step(1); } catch (error) { message = error.message; }
        const { steps, termination } = last.info;
        show([steps, last.reward, last.truncated, termination, message, capsule.metrics.mean_speed]);
    """
    ended = ["none", "pendulum", "contact", "diverged"][int(info["termination"])]
    speed, message = env.episode_metrics(1650)["mean_speed"], "the episode has ended: reset() first"
    assert node(code) == [steps, reward, False, ended, message, speed]


def test_disturbances_are_drawn_and_set_as_in_python(node):
    given = {"latency": [0.002, 0.011], "theta_noise": 0.01, "x_dot_bias": [-0.02, 0.02], "lag": 0.004, "push": 2.0}
    given |= {"theta_dot_resolution": 0.01, "unmeasured": ["theta_dot"], "controls": "agent"}
    ranges = {name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
    env = CapsuleEnv(controller="baselines:adaptive", disturbances=Disturbances(**ranges))
    plant = {"M": 0.5, "mu": 0.01}
    fixed = {**plant, "capsule": {"slope": 0.02, "m": 0.14}, "disturbances": {"latency": 0.007}}
    worlds, drawn = [], []
    # The seed also determines the second episode.
    for seed, options in ((2**40 + 5, plant), (None, fixed)):
        _, info = env.reset(seed=seed, options=options)
        drawn.append(info["disturbances"]["latency"])
        for n in range(80):
            env.step(np.array([0.02 * (n % 7 - 3)], np.float32))
        worlds.append(env.simulation.world[0, :, 0].tobytes().hex())
    code = f"""
        const capsule = await live.load("adaptive", {{ disturbances: {json.dumps(given)} }});
        const [worlds, drawn] = [[], []];
        for (const options of [{json.dumps({**plant, "seed": 2**40 + 5})}, {json.dumps(fixed)}]) {{
          drawn.push(capsule.reset(options).info.disturbances.latency);
          for (let n = 0; n < 80; n++) capsule.step(Math.fround(0.02 * (n % 7 - 3)));
          worlds.push(bytes(capsule.world));
        }}
        show([worlds, drawn, capsule.info.capsule.slope, Object.keys(capsule.info.reading)]);
    """
    assert node(code) == [worlds, drawn, 0.02, ["theta", "theta_dot", "x", "x_dot"]]
    assert 0.002 <= drawn[0] <= 0.011 and drawn[1] == 0.007


@pytest.mark.parametrize(("task", "options", "disturbances"), TASKS)
def test_tasks_have_pythons_observations_and_metrics(node, task, options, disturbances):
    env = CapsuleEnv(task=task, controller=f"baselines:{task}_pulses", disturbances=Disturbances(**disturbances))
    observation, info = env.reset(seed=3, options={"M": 0.5, "mu": 0.2, **options})
    for _ in range(300):
        observation, _, _, _, info = env.step(np.zeros(1, np.float32))
    metrics = env.episode_metrics(None)
    given = {"M": 0.5, "mu": 0.2, "seed": 3, "disturbances": disturbances, **options}
    code = f"""
        const episode = await live.drive("{task}-pulses", {json.dumps(given)});
        for (let n = 0; n < 300; n++) episode.tick();
        show([episode.task, bytes(episode.observation), episode.info.error, episode.metrics]);
    """
    found = node(code)
    assert found[:3] == [task, observation.tobytes().hex(), float(info["error"])]
    own = {name: value for name, value in metrics.items() if np.isfinite(value)}
    assert {name: found[3][name] for name in own} == own and len(own) >= 14


def test_types_declare_what_there_is(node):
    types = (ROOT / "web/capsule.d.mts").read_text(encoding="utf-8")
    declared = re.findall(r"^export (?:class|function|const) (\w+)", types, re.MULTILINE)
    assert sorted(declared) == node("show(Object.keys(live).sort());")


# Calls, and the errors that they raise.
BAD = {
    'await live.load("sliding")': "RangeError: controller must be one of direct, adaptive,.*, got sliding",
    'await live.load("direct", { disturbances: { lag: [2, 1] } })': "RangeError: disturbances.lag must be .* got 2,1",
    'await live.load("direct", { disturbances: { lag: [] } })': "RangeError: disturbances.lag must be .* got $",
    'await live.load("direct", { set: "paper", task: "goal" })': "RangeError: task must be left out: the set says it",
    'await live.drive("pd", { set: "goal", plant: 0 })': "RangeError: set must be one of the task speed, got goal",
    "capsule.reset({ seed: 1 })": "RangeError: seed must be left out: nothing is drawn",
    'await live.drive("dp-oracle")': "RangeError: set and plant must be given: what dp-oracle does",
    'await live.drive("epc", { set: "paper", plant: 100 })': "RangeError: plant must be .* 0 to 99, got 100",
    "capsule.reset({ M: 0 })": r"RangeError: M must be a finite number in \[0.2, 2\], got 0",
    "capsule.reset({ changes: [{ t: -1, M: 0.5, mu: 0 }] })": r"RangeError: changes\[0\].t must be .*, got -1",
    "capsule.step(NaN)": "RangeError: action must be a finite number, got NaN",
    'capsule.restore((await live.load("epc")).snapshot())': "RangeError: snapshot must be one of",
}


def test_bad_input_is_named(node):
    code = "try {{ {}; errors.push(null); }} catch (caught) {{ errors.push(`${{caught.name}}: ${{caught.message}}`); }}"
    script = f"""
        const capsule = await live.load("direct");
        const before = bytes(capsule.world);
        const errors = [];{"".join(map(code.format, BAD))}
        show([errors, bytes(capsule.world) === before]);
    """
    errors, untouched = node(script)
    assert untouched
    for (call, message), error in zip(BAD.items(), errors, strict=True):
        kind, _, said = message.partition(": ")
        assert error.startswith(f"{kind}: ") and re.search(said, error), (call, error)


def test_the_documented_examples_run(node):
    page = (ROOT / "docs" / "live.md").read_text(encoding="utf-8")
    examples = re.findall(r"^```js\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert examples
    for example in examples:
        body, imported = re.subn(r'^import \{.*\} from "\./capsule\.mjs";\n', "", example, flags=re.MULTILINE)
        assert imported == 1
        outputs = re.findall(r"console\.log\(.*\); // (.*)", body)
        code = "const { load, drive, check, drivers, constants } = live; const lines = []; const console_ = console;\n"
        code += "{ const console = { log: (...words) => lines.push(words.join(' ')) };\n" + body + "}\nshow(lines);"
        assert node(code) == outputs
