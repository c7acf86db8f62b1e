"""The module for browsers in node: Python's bits, the module's interface, and its errors."""

import json
import re

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, Disturbances, load_policy
from capsule_gym.evaluation.sets import SET_NAMES, load_set
from tests import ROOT
from web import build, data, episodes

COMMITTED = json.loads(episodes.FILE.read_text(encoding="utf-8"))
TASKS = [("goal", {"goal": -0.07}, {"x_noise": 0.001})]
TASKS += [
    (
        "velocity",
        {"commands": [{"t": 0.0, "v": 0.05}, {"t": 4.0, "v": -0.08}]},
        {"x_dot_bias": 0.02},
    )
]


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
    assert {each.shape for each in recorded.values()} == {
        (2, 30)
    } and "dp-nominal paper" in recorded
    np.savez_compressed(
        episodes.RECORDINGS, **{**recorded, "dp-nominal paper": recorded["dp-nominal paper"] + 1}
    )
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


@pytest.fixture
def mine(tmp_path):
    """JavaScript that reads `mine`, the description of a policy."""
    described = data.describe_policy("mine", load_policy("residual-ppo"))
    file = tmp_path / "mine.json"
    file.write_text(
        json.dumps({**described, "network": described["network"].tolist()}), encoding="utf-8"
    )
    read = f"JSON.parse(readFileSync({json.dumps(str(file))}))"
    return f'import {{ readFileSync }} from "node:fs";\nconst mine = {read};\n'


def test_a_policy_of_ones_own_gives_the_bits_of_the_one_that_came_with_the_module(node, mine):
    code = """
        live.addDriver(mine);
        const worlds = [];
        for (const name of ["residual-ppo", "mine"]) {
          const episode = await live.drive(name, { M: 0.6, mu: 0.02 });
          for (let n = 0; n < 60; n++) episode.tick();
          worlds.push(bytes(episode.world));
        }
        const refused = [];
        for (const wrong of [{}, { name: 1 }, { name: "a", task: "moon" }]) {
          try { live.addDriver({ ...mine, ...wrong }); } catch (error) { refused.push(error.message); }
        }
        show([worlds, live.drivers.at(-1), refused]);
    """
    (own, shown, refused) = node(mine + code)
    assert own[0] == own[1] and "network" not in shown
    assert shown["name"] == "mine" and shown["controlDt"] == 0.02
    words = ["got mine", "must be a string, got 1", "got moon"]
    assert all(word in message for message, word in zip(refused, words, strict=True)), refused


# Options of a driver, as JavaScript, and the errors that they raise.
WRONG_OPTIONS = {
    "mu: undefined": "TypeError: options.mu must be .*, got undefined",
    "M: null": "TypeError: options.M must be .*, got null",
    "k: NaN": "RangeError: options.k must be .*, got NaN",
    "stack_size: 101": r"RangeError: options.stack_size must be .* in \[1, 100\], got 101",
    "stack_size: 1.5": "TypeError: options.stack_size must be a whole number",
    "physics_dt: 1e-9": "RangeError: options.control_dt must be .*, at most 1000000",
    "control_dt: 0.0205": "RangeError: options.control_dt must be a multiple of",
    "M_low: 1, M_high: 0.9": "RangeError: options.M_low must be .* up to 0.9, got 1",
    "mu_low: 1": "RangeError: options.mu_low must be .* up to null, got 1",
    "initial_theta: 1": "RangeError: options.initial_theta and .* together",
    "disturbances_latency_high: 0.6": r"RangeError: .*latency_high must be .* in \[0, 0.5\]",
    "disturbances_latency_low: -1": r"RangeError: .*latency_low must be .* in \[0, 0.5\]",
    "disturbances_latency_low: 0.1": "RangeError: .*latency_low must be .* up to 0, got 0.1",
    # It adds two entries to the observation.
    "observe_parameters: 1": "RangeError: network must be .* for 12 entries, got",
}
# Other parts of a driver.
WRONG_PARTS = {
    "options: null": "TypeError: options must be an object with fields out of",
    "options: { history: 1 }": "RangeError: options must be .*, got history",
    "kind: 'law'": "RangeError: kind must be one of policy, got law",
    "controller: 'toString'": "RangeError: controller must be one of .*, got toString",
    "recordings: {}": "RangeError: driver must be .*, got recordings",
    "network: mine.network.slice(8)": "RangeError: network must be .* for 10 entries, got",
    "network: [1]": "RangeError: network must be .* for 10 entries, got 1 numbers",
    "network: [NaN]": r"RangeError: network\[0\] must be a finite number, got NaN",
    "network: Array(9)": r"TypeError: network\[0\] must be a finite number, got undefined",
    # A width of 2000 units, and a number of layers that is not whole.
    "network: mine.network.with(9, 2000)": "RangeError: network must be .* for 10 entries",
    "network: mine.network.with(0, 2.5)": "RangeError: network must be .* for 10 entries",
}


def test_a_driver_that_does_not_fit_is_refused(node, mine):
    wrong = {
        f"options: {{ ...mine.options, {option} }}": error
        for option, error in WRONG_OPTIONS.items()
    } | WRONG_PARTS
    attempts = "".join(f"attempt(() => ({{ {part} }}));\n" for part in wrong)
    code = f"""
        const errors = [];
        const attempt = (part) => {{
          try {{
            live.addDriver({{ ...mine, ...part() }});
            errors.push(null);
          }} catch (error) {{
            errors.push(`${{error.name}}: ${{error.message}}`);
          }}
        }};
        {attempts}
        show([errors, live.drivers.some(({{ name }}) => name === "mine")]);
    """
    errors, added = node(mine + code)
    assert not added
    for (part, message), error in zip(wrong.items(), errors, strict=True):
        assert error is not None and re.match(message, error), (part, error)


def test_a_driver_has_one_value_for_each_field(node, mine):
    # A field that returns something else after its check.
    code = """
        let reads = 0;
        const options = { ...mine.options, get disturbances_latency_low() { return reads++ === 0 ? 0 : 0.5; } };
        live.addDriver({ ...mine, options });
        const episode = await live.drive("mine");
        show([reads, episode.description.layout.rows]);
    """
    rows = CapsuleEnv(controller="baselines:adaptive").simulation.layout.rows
    assert node(mine + code) == [1, rows]


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
    assert delay < states == kept


@pytest.mark.parametrize("name", episodes.RECORDED)
def test_recordings_are_what_the_policies_do(name):
    known = np.load(episodes.RECORDINGS)
    assert [key for key in known if key.startswith(name)] == [
        f"{name} {each}" for each in SET_NAMES
    ]
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
    given = {
        "latency": [0.002, 0.011],
        "theta_noise": 0.01,
        "x_dot_bias": [-0.02, 0.02],
        "lag": 0.004,
        "push": 2.0,
    }
    given |= {"theta_dot_resolution": 0.01, "unmeasured": ["theta_dot"], "controls": "agent"}
    ranges = {
        name: tuple(value) if isinstance(value, list) else value for name, value in given.items()
    }
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


def test_a_latency_between_two_periods_is_accepted_up_to_its_end(node):
    given = {"latency": (0.0, 0.0409)}
    env = CapsuleEnv(disturbances=Disturbances(**given))
    plant = {"M": 0.5, "mu": 0.01, "disturbances": {"latency": 0.0409}}
    env.reset(seed=7, options=plant)
    for n in range(60):
        env.step(np.array([0.02 * (n % 7 - 3)], np.float32))
    longest = env.simulation.settings.longest_latency
    code = f"""
        const capsule = await live.load("direct", {{ disturbances: {json.dumps(given)} }});
        capsule.reset({json.dumps({**plant, "seed": 7})});
        for (let n = 0; n < 60; n++) capsule.step(Math.fround(0.02 * (n % 7 - 3)));
        let message = "";
        try {{ capsule.reset({{ disturbances: {{ latency: 0.0421 }} }}); }} catch (error) {{ message = error.message; }}
        show([bytes(capsule.world), message]);
    """
    world, message = node(code)
    assert world == env.simulation.world[0, :, 0].tobytes().hex()
    assert (
        message == f"disturbances.latency must be a finite number in [0, {longest!r}], got 0.0421"
    )


@pytest.mark.parametrize(("task", "options", "disturbances"), TASKS)
def test_tasks_have_pythons_observations_and_metrics(node, task, options, disturbances):
    env = CapsuleEnv(
        task=task, controller=f"baselines:{task}_pulses", disturbances=Disturbances(**disturbances)
    )
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
        body, imported = re.subn(
            r'^import \{.*\} from "\./capsule\.mjs";\n', "", example, flags=re.MULTILINE
        )
        assert imported == 1
        outputs = re.findall(r"console\.log\(.*\); // (.*)", body)
        code = "const { load, drive, check, drivers, constants } = live; const lines = []; const console_ = console;\n"
        code += (
            "{ const console = { log: (...words) => lines.push(words.join(' ')) };\n"
            + body
            + "}\nshow(lines);"
        )
        assert node(code) == outputs
