"""Policies that a user adds to the browser's module."""

import json

import pytest

from agents.leaderboard.page import OTHER_LAWS
from capsule_gym import CapsuleEnv, Policy, load_policy
from tests.capsule_gym.policies.test_policy import make_policy_on
from tests.capsule_gym.policies.test_recurrent import recurrent_policy, vectors
from tests.web.conftest import check_errors
from web import data
from web.episodes import drivers


@pytest.fixture
def mine(tmp_path):
    """JavaScript that reads `mine`, the description of a policy."""
    described = data.describe_policy("mine", load_policy("residual-ppo"))
    described["network"] = described["network"].tolist()
    file = tmp_path / "mine.json"
    file.write_text(json.dumps(described), "utf-8")
    return f"""
        import {{ readFileSync }} from "node:fs";
        const mine = JSON.parse(readFileSync({json.dumps(str(file))}));
    """


def test_an_added_policy_gives_the_bits_of_the_one_in_the_module(node, mine):
    code = """
        live.addDriver(mine);
        const worlds = [];
        for (const name of ["residual-ppo", "mine"]) {
          const episode = await live.drive(name, { M: 0.6, mu: 0.02 });
          for (let n = 0; n < 60; n++) episode.tick();
          worlds.push(bytes(episode.world));
        }
        show(worlds);
    """
    own, added = node(mine + code)
    assert own == added


@pytest.mark.parametrize("kind", ["gru", "lstm"])
def test_a_recurrent_policy_has_the_bits_of_python(node, kind):
    policy = recurrent_policy(kind)
    described = data.describe_policy(kind, policy)
    described["network"] = described["network"].tolist()
    # An episode, which is begun again, and one of which a part is repeated.
    code = f"""
        live.addDriver({json.dumps(described)});
        const episode = await live.drive({json.dumps(kind)}, {{ M: 0.6, mu: 0.02 }});
        const actions = [];
        const run = (steps) => {{
          for (let n = 0; n < steps; n++) {{
            episode.tick();
            actions.push(episode.action);
          }}
        }};
        run(12);
        episode.reset({{ M: 0.6, mu: 0.02 }});
        run(4);
        const snapshot = episode.snapshot();
        run(8);
        episode.restore(snapshot);
        run(8);
        show([actions, [...episode.memory]]);
    """
    env = CapsuleEnv(**policy.env_kwargs)
    observation, _ = env.reset(options={"M": 0.6, "mu": 0.02})
    state = None
    expected = []
    for _ in range(12):
        action, state = policy.predict(observation, state)
        expected.append(float(action[0]))
        observation, *_ = env.step(action)
    (units,) = vectors(state, policy)[0]
    actions, memory = node(code)
    assert actions == expected + expected[:4] + 2 * expected[4:]
    assert memory == units.tolist()


def test_drivers_show_an_added_policy_without_its_network(node, mine):
    driver = node(mine + "live.addDriver(mine); show(live.drivers.at(-1));")
    assert driver["name"] == "mine"
    assert driver["controlDt"] == 0.02
    assert driver["seed"] == 0
    assert "network" not in driver


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
    "disturbances_motor_friction_high: 0.3": r"RangeError: .*high must be .* in \[0, 0.2\]",
    "disturbances_latency_high: 0.6": r"RangeError: .*latency_high must be .* in \[0, 0.5\]",
    "disturbances_latency_low: -1": r"RangeError: .*latency_low must be .* in \[0, 0.5\]",
    "disturbances_latency_low: 0.1": "RangeError: .*latency_low must be .* up to 0, got 0.1",
    # It adds two entries to the observation.
    "observe_parameters: 1": "RangeError: network must be .* for 12 entries, got",
}
# Other parts of a driver.
WRONG_PARTS = {
    "name: 'pd'": "RangeError: name must be a new one, got pd",
    "name: 1": "TypeError: name must be a string, got 1",
    "task: 'moon'": "RangeError: task with .* must be one of .*, got moon",
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
    wrong = dict(WRONG_PARTS)
    for option, pattern in WRONG_OPTIONS.items():
        wrong[f"options: {{ ...mine.options, {option} }}"] = pattern
    calls = ",\n".join(f"() => live.addDriver({{ ...mine, {part} }})" for part in wrong)
    code = f"""
        const errors = await errorsOf([{calls}]);
        show([errors, live.drivers.some(({{ name }}) => name === "mine")]);
    """
    errors, added = node(mine + code)
    assert not added
    check_errors(wrong, errors)


def test_a_policy_on_a_law_of_another_package_has_no_description():
    policy = make_policy_on("tests.agents.fakes:quiet")
    message = "controller must be None or a law of baselines, got tests.agents.fakes:quiet"
    with pytest.raises(ValueError, match=message):
        data.describe_policy("mine", policy)


def test_every_policy_of_the_module_has_a_group():
    found = {name: data.group_of(policy) for name, policy in drivers().items()}
    assert {found[name] for name in OTHER_LAWS} == {"The paper"}
    assert found["goal"] == "Learned"
    assert found["goal-pulses"] == "Simple feedback"


def test_trained_policies_of_other_tasks_come_last():
    trained = [policy for policy in drivers().values() if isinstance(policy, Policy)]
    others = ["task" in policy.env_kwargs for policy in trained]
    assert others == sorted(others)
    assert True in others


def test_a_driver_has_one_value_for_each_field(node, mine):
    # A field that returns something else after its check.
    code = """
        let reads = 0;
        const options = {
          ...mine.options,
          get disturbances_latency_low() { return reads++ === 0 ? 0 : 0.5; },
        };
        live.addDriver({ ...mine, options });
        const episode = await live.drive("mine");
        show([reads, episode.description.layout.rows]);
    """
    rows = CapsuleEnv(controller="baselines:adaptive").simulation.layout.rows
    assert node(mine + code) == [1, rows]
