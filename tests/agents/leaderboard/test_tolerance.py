import math

import numpy as np
import pytest

from agents.evaluation.candidates import find_candidate
from agents.evaluation.episodes import evaluate, summarise
from agents.leaderboard import tolerance
from agents.leaderboard.tolerance import Disturbed, agree, agree_counts, measure
from tests.agents.fakes import Sine, Twitch
from tests.agents.leaderboard.world import HORIZON, SETS, make_set

PAPER = SETS[1]


def test_noise_is_a_ten_millionth_of_full_action():
    policy = Sine(1.0)
    disturbed = Disturbed(policy, 3)
    assert (disturbed.name, disturbed.env_kwargs) == (policy.name, policy.env_kwargs)
    seeds = list(range(1000))
    quiet, noisy, same, other = (p.start(seeds) for p in (policy, disturbed, disturbed, Disturbed(policy, 4)))
    observations = np.zeros((1000, 5), np.float32)
    for _ in range(9):
        actions, found = quiet(observations), noisy(observations)
        assert found.dtype == np.float32
        assert found.tobytes() == same(observations).tobytes() != other(observations).tobytes()
        # Rounding to float32 adds to it.
        assert (found - actions).std() == pytest.approx(1e-7, rel=0.2)
    assert np.std(Disturbed(Sine(0.0), 0).start(seeds)(observations)) == pytest.approx(1e-7, rel=0.1)


@pytest.mark.usefixtures("world")
def test_spread_tells_a_chaotic_policy_from_a_stable_one():
    stable, chaotic = (measure(find_candidate(name), PAPER, HORIZON) for name in ("bold", "twitch"))
    assert measure(find_candidate("twitch"), PAPER, HORIZON) == chaotic
    assert stable["mean_speed"]["iqm"] < 1e-6
    assert stable["failures"] == 0
    assert chaotic["mean_speed"]["iqm"] > 0.1
    # None failed, but where copies part one may.
    assert chaotic["failures"] == 1
    assert measure(find_candidate("wild"), PAPER, HORIZON)["failures"] == 0
    # A single plant without training seeds has no interval, and so no spread of its ends.
    single = measure(find_candidate("twitch"), SETS[0], HORIZON)["mean_speed"]
    assert single["iqm"] > chaotic["mean_speed"]["iqm"]
    assert single["low"] == single["high"] == 0.0


@pytest.mark.usefixtures("world")
def test_the_tolerance_holds_for_noise_that_it_was_not_measured_with(monkeypatch):
    monkeypatch.setattr(tolerance, "EPISODES", 300)
    monkeypatch.setattr(tolerance, "EVALUATIONS", 100)
    plants = make_set("paper", *((0.45 + 0.01 * i, 0.01) for i in range(10)))
    spread = measure(find_candidate("twitch"), plants, HORIZON)
    recorded = summarise(evaluate(Twitch(), plants, horizon=HORIZON))
    moved = 0.0
    for seed in range(50):
        found = summarise(evaluate(Disturbed(Twitch(), seed), plants, horizon=HORIZON))
        moved = max(moved, abs(found["mean_speed"]["iqm"] - recorded["mean_speed"]["iqm"]))
        for metric in ("mean_speed", "rms_torque"):
            for end in ("iqm", "low", "high"):
                assert agree(recorded[metric][end], found[metric][end], spread[metric][end]), (seed, metric, end)
    # The tolerance is no wider than a few times what chance does.
    assert tolerance.MULTIPLE * spread["mean_speed"]["iqm"] < 5.0 * moved


def test_a_number_that_exists_only_sometimes_has_an_infinite_spread():
    assert tolerance._width([1.0, 3.0, 2.0]) == 2.0
    assert tolerance._width([1.0, math.inf]) == tolerance._width([math.nan, 1.0]) == math.inf
    assert tolerance._width([math.inf, math.nan]) == 0.0


@pytest.mark.parametrize(
    ("recorded", "found", "spread", "expected"),
    [
        (10.0, 10.009, 0.0, True),
        (10.0, 10.011, 0.0, False),
        (0.0, 9e-5, 0.0, True),
        (0.0, 2e-4, 0.0, False),
        (10.0, 9.6, 0.2, True),
        (10.0, 9.5, 0.2, False),
        (None, None, 0.0, True),
        (None, 1.0, 0.2, False),
        (1.0, None, 0.2, False),
        (1.0, None, None, True),
        (1.0, 99.0, None, True),
    ],
)
def test_agreement(recorded, found, spread, expected):
    assert agree(recorded, found, spread) is expected


def test_agreement_of_counts_knows_no_rounding():
    assert agree_counts(84, 84, 0)
    assert not agree_counts(84, 85, 0)
    assert agree_counts(84, 90, 3)
    assert not agree_counts(84, 91, 3)
