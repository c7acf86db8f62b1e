"""The module in node: Python's bits, its interface, and what it refuses."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

from agents.controllers import describe_policy
from agents.leaderboard.rows import RESULTS, load_row, path_of
from capsule_gym import CapsuleEnv, load_policy
from capsule_gym.layout import Row
from capsule_gym.task import METRICS
from tests import bits
from tests.web.conftest import Node
from web import build, data, episodes, recordings

ROOT = Path(__file__).resolve().parents[2]
COMMITTED = json.loads(episodes.FILE.read_text(encoding="utf-8"))


# --- bits ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["zero", "adaptive", "robust", "held torques on adaptive, 2"])
def test_committed_episodes_are_pythons(name: str) -> None:
    committed = next(course for course in COMMITTED if course["name"] == name)
    assert episodes.compute(committed) == (committed["steps"], committed["sha256"])


def test_every_driver_has_an_episode_and_some_fail() -> None:
    assert [course["driver"] for course in COMMITTED][: len(episodes.controller_names())] == episodes.controller_names()
    assert {course["name"] for course in COMMITTED} == {course["name"] for course in episodes.courses()}
    assert any(course["steps"] < 1650 for course in COMMITTED)


def test_the_module_replays_every_committed_episode(node: Node) -> None:
    all_equal, reports = node("const reports = []; show([await live.check((r) => reports.push(r)), reports]);")
    assert [report["name"] for report in reports] == [course["name"] for course in COMMITTED]
    assert [report["steps"] for report in reports] == [course["steps"] for course in COMMITTED]
    assert all_equal and all(report["equal"] for report in reports)
    assert sum(report["doubles"] for report in reports) > 1_000_000


def test_a_single_bit_fails_the_check(node: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    committed = {key: value for key, value in COMMITTED[0].items() if key not in ("set", "plant")}
    plant = data.describe_plant(data.load_set(COMMITTED[0]["set"]).plants[COMMITTED[0]["plant"]])
    altered = [{**committed, **plant, "mu": float(np.nextafter(plant["mu"], 1.0))}]
    monkeypatch.setattr(data, "FILE", tmp_path / "episodes.json")
    data.FILE.write_text(json.dumps(altered), encoding="utf-8")
    module = tmp_path / "capsule.mjs"
    module.write_text(build.build_module(data.pack_data()), encoding="utf-8")
    assert node("show(await live.check());", module=module) is False


def test_a_law_gives_the_hash_of_the_batch(node: Node, tmp_path: Path) -> None:
    """Every environment of a subject of `tests.bits`, whose hash is over a whole batch and its metrics."""
    subject = next(subject for subject in bits.subjects() if subject.name == "law adaptive")
    env = bits.batch(subject)
    env.reset(seed=0)
    plants = env.simulation.rows(Row.M, Row.mu + 1).T.tolist()
    env.close()
    act = subject.start(range(bits.NUM_ENVS))
    none = np.zeros((bits.NUM_ENVS, 1), np.float32)
    actions = np.array([act(none)[:, 0] for _ in range(subject.steps)]).T
    (tmp_path / "given.json").write_text(json.dumps({"plants": plants, "actions": actions.tolist()}), encoding="utf-8")
    code = """
        import { readFileSync, writeFileSync } from "node:fs";
        const folder = process.argv[1];
        const { plants, actions } = JSON.parse(readFileSync(`${folder}/given.json`));
        const capsule = await live.load("adaptive");
        const [observations, numbers, metrics] = [[], [], []];
        plants.forEach(([M, mu], i) => {
          capsule.reset({ M, mu });
          let over = false;
          for (const action of actions[i]) {
            // Who has failed stands still.
            const { reward, terminated } = over ? { reward: 0, terminated: true } : capsule.step(action);
            over = terminated;
            observations.push(capsule.observation);
            numbers.push(Float64Array.of(reward, ...Object.values(capsule.state)));
          }
          metrics.push(Float64Array.from(Object.values(capsule.metrics)));
        });
        const write = async (name, arrays) =>
          writeFileSync(`${folder}/${name}`, new Uint8Array(await new Blob(arrays).arrayBuffer()));
        await write("observations", observations);
        await write("numbers", numbers);
        await write("metrics", metrics);
        show(Object.keys(capsule.metrics));
    """
    assert node(code, str(tmp_path)) == list(METRICS)
    shape = bits.NUM_ENVS, subject.steps, -1
    observations = np.fromfile(tmp_path / "observations", np.float32).reshape(shape).swapaxes(0, 1)
    numbers = np.fromfile(tmp_path / "numbers").reshape(shape).swapaxes(0, 1)
    metrics = np.fromfile(tmp_path / "metrics").reshape(bits.NUM_ENVS, -1).T
    digest = hashlib.sha256()
    for array in (observations, numbers[..., 0], numbers[..., 1:], *metrics):
        digest.update(np.ascontiguousarray(array).tobytes())
    assert digest.hexdigest() == json.loads(bits.FILE.read_text(encoding="utf-8"))[subject.name]


def test_a_policy_of_ones_own_gives_the_bits_of_the_one_that_came_with_the_module(node: Node, tmp_path: Path) -> None:
    described = describe_policy("mine", load_policy("residual-ppo"))
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
        const attempts = [{}, { name: 1 }, { name: "a", task: "moon" }, { name: "a", settings: { fixed: [] } }];
        for (const wrong of [...attempts, { name: "a", units: 0 }, { name: "a", network: [NaN] }]) {
          try { live.addDriver({ ...mine, ...wrong }); } catch (error) { refused.push(error.message); }
        }
        show([worlds, live.drivers.at(-1), refused]);
    """
    (own, shown, refused) = node(code, str(tmp_path / "mine.json"))
    assert own[0] == own[1]
    assert shown["name"] == "mine" and shown["controlDt"] == described["settings"]["control_dt"]
    assert "network" not in shown
    words = ["got mine", "must be a string, got 1", "got moon", "settings.fixed must be", "units must be", "network[0]"]
    assert len(refused) == len(words)
    for message, word in zip(refused, words, strict=True):
        assert word in message


@pytest.mark.parametrize("name", recordings.RECORDED)
def test_recordings_are_what_the_policies_do(name: str) -> None:
    known = recordings.known_recordings()[name]
    assert {each: places.shape[0] for each, places in known.items()} == dict.fromkeys(data.SET_NAMES, 100)
    for each, n in (("wide", 17), ("drift", 4)):
        assert recordings.record(name, [data.load_set(each).plants[n]])[0].tolist() == known[each][n].tolist()


@pytest.mark.parametrize(("name", "plant"), [("nominal", 41), ("extrapolation", 5)])
def test_every_driver_has_the_leaderboards_numbers(node: Node, name: str, plant: int) -> None:
    code = """
        const [set, plant] = [process.argv[1], Number(process.argv[2])];
        const found = {};
        for (const { name } of live.drivers) {
          const episode = await live.drive(name, { set, plant });
          for (let over = false; !over; ) {
            const { terminated, truncated } = episode.tick();
            over = terminated || truncated;
          }
          const { mean_speed, peak_torque, duration } = episode.metrics;
          found[name] = [mean_speed, peak_torque, duration];
        }
        show(found);
    """
    found = node(code, name, str(plant))
    assert list(found) == episodes.controller_names()
    for driver, numbers in found.items():
        row = load_row(path_of(ROOT / RESULTS, driver))
        # Of a policy the run with the lowest seed.
        assert numbers == [row.score(name, metric)[0, plant] for metric in ("mean_speed", "peak_torque", "duration")]


def test_random_torques_are_numpys(node: Node) -> None:
    code = """
        const episode = await live.drive("random", { seed: 9 });
        const start = episode.snapshot();
        const drawn = () => Array.from({ length: 20 }, () => (episode.tick(), episode.action));
        const first = drawn();
        episode.restore(start);
        show([first, drawn()]);
    """
    expected = np.random.default_rng([9, 1]).uniform(-1.0, 1.0, 20).astype(np.float32).tolist()
    assert node(code) == [expected, expected]


def test_a_policy_is_told_another_energy_weight(node: Node) -> None:
    policy = load_policy("pareto").with_energy_weight(7.3)
    env = CapsuleEnv(**policy.env_kwargs)
    observation, _ = env.reset(options={"M": 0.5, "mu": 0.01})
    act = policy.start([0])
    for _ in range(60):
        observation, *_ = env.step(act(observation))
    world = env.simulation.world[0, :, 0].tobytes().hex()
    env.close()
    code = """
        const episode = await live.drive("pareto", { energyWeight: 7.3 });
        for (let n = 0; n < 60; n++) episode.tick();
        show(bytes(episode.world));
    """
    assert node(code) == world
    assert node(code.replace("7.3", "7.4")) != world


# --- interface -------------------------------------------------------------------------------------------------------


def test_a_restored_episode_goes_on_as_it_did(node: Node) -> None:
    code = """
        const episode = await live.drive("robust", { changes: [{ t: 3, M: 0.4, mu: 0.1 }] });
        const run = (steps) => { for (let n = 0; n < steps; n++) episode.tick(); return bytes(episode.world); };
        run(100);
        const snapshot = episode.snapshot();
        const [first, action] = [run(100), episode.action];
        episode.restore(snapshot);
        const back = episode.info.steps;
        show([back, first === run(100), action === episode.action, episode.info.M]);
    """
    assert node(code) == [100, True, True, 0.4]


def test_a_plant_jumps_by_hand_as_by_schedule(node: Node) -> None:
    code = """
        const planned = await live.drive("gait-guarded", { changes: [{ t: 2, M: 0.6, mu: 0.05 }] });
        const byHand = await live.drive("gait-guarded");
        for (let n = 0; n < 200; n++) {
          if (n === 100) byHand.setPlant({ M: 0.6, mu: 0.05 });
          [planned, byHand].forEach((episode) => episode.tick());
        }
        show([bytes(planned.world) === bytes(byHand.world), byHand.info.mu]);
    """
    assert node(code) == [True, 0.05]


def test_a_second_reset_begins_anew(node: Node) -> None:
    code = """
        const episode = await live.drive("robust", { M: 0.6 });
        const run = () => { for (let n = 0; n < 150; n++) episode.tick(); return bytes(episode.world); };
        const first = run();
        episode.reset({ M: 0.6 });
        show([first === run(), episode.info.M]);
    """
    assert node(code) == [True, 0.6]


def test_an_episode_ends_as_pythons(node: Node) -> None:
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
    metrics = env.episode_metrics()
    env.close()
    message = "the episode has ended: reset() first"
    assert node(code) == [steps, reward, False, ended, message, metrics["mean_speed"]]


def test_drivers_and_sets_are_what_python_has(node: Node) -> None:
    drivers, sets, tasks = node("show([live.drivers, live.sets, live.tasks]);")
    assert [driver["name"] for driver in drivers] == episodes.controller_names()
    assert {driver["task"] for driver in drivers} == set(tasks)
    assert all(driver["description"] for driver in drivers)
    assert {driver["name"] for driver in drivers if driver.get("recorded")} == set(recordings.RECORDED)
    assert {driver["name"] for driver in drivers if driver.get("seeds")} == {"random"}
    assert [driver["energyWeight"] for driver in drivers if "energyWeight" in driver] == [[0.1, 20.0]]
    frozen = {name: data.load_set(name) for name in data.SET_NAMES}
    assert {name: each["hash"] for name, each in sets.items()} == {name: each.hash for name, each in frozen.items()}
    assert all(len(each["plants"]) == len(frozen[name].plants) for name, each in sets.items())


def test_types_declare_what_there_is(node: Node) -> None:
    types = (ROOT / "web/capsule.d.mts").read_text(encoding="utf-8")
    declared = re.findall(r"^export (?:class|function|const) (\w+)", types, re.MULTILINE)
    assert sorted(declared) == node("show(Object.keys(live).sort());")


@pytest.mark.parametrize(
    ("code", "kind", "message"),
    [
        ('await live.load("sliding")', "RangeError", "task must be one of direct, adaptive,.*, got sliding"),
        ('await live.drive("nobody")', "RangeError", "driver must be one of zero,.*, got nobody"),
        ('await live.drive("robust", { energyWeight: 1 })', "RangeError", "energyWeight must be left out: robust"),
        (
            'await live.drive("pareto", { energyWeight: 0 })',
            "RangeError",
            r"energyWeight must be .* in \[0.1, 20\], got 0",
        ),
        ('await live.drive("optimum-oracle")', "RangeError", "set and plant must be given: what optimum-oracle does"),
        ('await live.drive("optimum-oracle", { M: 0.5, mu: 0.1 })', "RangeError", "set and plant must be given"),
        ('await live.drive("epc", { set: "moon", plant: 0 })', "RangeError", "set must be one of nominal,.*, got moon"),
        ('await live.drive("epc", { set: "paper", plant: 100 })', "RangeError", "plant must be .* 0 to 99, got 100"),
        ('await live.drive("epc", { set: "paper" })', "TypeError", "plant must be a whole number .* got undefined"),
        ('await live.drive("epc", { set: "paper", plant: 1, M: 1 })', "RangeError", "set and plant must stand without"),
        ('await live.drive("epc", { seed: 1 })', "RangeError", "seed must be left out: epc draws nothing"),
        ('await live.drive("random", { seed: 0.5 })', "TypeError", "seed must be a whole number from 0 to 99, got 0.5"),
        ("capsule.reset({ M: 0 })", "RangeError", r"M must be a finite number in \[0.2, 2\], got 0"),
        ('capsule.reset({ mu: "0.1" })', "TypeError", r"mu must be a finite number in \[0, 1\], got 0.1"),
        ("capsule.reset({ theta: 2 })", "RangeError", "theta must be .*, got 2"),
        ("capsule.reset({ theta: Math.PI / 2 })", "RangeError", "theta must be .*, got 1.57"),
        ("capsule.reset({ speed: 2 })", "RangeError", "reset takes M, mu, .*, got speed"),
        ("capsule.reset({ changes: {} })", "TypeError", "changes must be an array"),
        ("capsule.reset({ changes: [{ t: -1, M: 0.5, mu: 0 }] })", "RangeError", r"changes\[0\].t must be .*, got -1"),
        ("capsule.reset({ changes: [{ t: 1, M: 9, mu: 0 }] })", "RangeError", r"changes\[0\].M must be .*, got 9"),
        ("capsule.setPlant({ M: 0.5 })", "TypeError", "mu must be .*, got undefined"),
        ("capsule.step(NaN)", "RangeError", "action must be a finite number, got NaN"),
        ("capsule.step()", "TypeError", "action must be a finite number, got undefined"),
        ('capsule.restore((await live.load("epc")).snapshot())', "RangeError", "snapshot must be one of"),
    ],
)
def test_bad_input_is_named(node: Node, code: str, kind: str, message: str) -> None:
    script = f"""
        const capsule = await live.load("direct");
        const before = bytes(capsule.world);
        let error = null;
        try {{ {code}; }} catch (caught) {{ error = caught; }}
        show([error?.name, error?.message, bytes(capsule.world) === before]);
    """
    name, text, untouched = node(script)
    assert (name, untouched) == (kind, True)
    assert re.search(message, text)


# --- the page that shows it ------------------------------------------------------------------------------------------


def test_the_documented_examples_run(node: Node) -> None:
    page = (ROOT / "docs" / "live.md").read_text(encoding="utf-8")
    examples = re.findall(r"^```js\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert examples
    for example in examples:
        body, imported = re.subn(r'^import \{.*\} from "\./capsule\.mjs";\n', "", example, flags=re.MULTILINE)
        assert imported == 1
        outputs = re.findall(r"console\.log\(.*\); // (.*)", body)
        code = f"const {{ {', '.join(node_exports())} }} = live; const lines = []; const console_ = console;\n"
        code += "{ const console = { log: (...words) => lines.push(words.join(' ')) };\n" + body + "}\nshow(lines);"
        assert node(code) == outputs


def node_exports() -> list[str]:
    """What the examples may take from the module."""
    return ["load", "drive", "check", "drivers", "constants"]
