import numpy as np
import pytest

from agents.evaluation.policies import find_candidate
from agents.leaderboard.chaos import NOISE, Disturbed, measure
from tests.agents.fakes import Sine
from tests.agents.leaderboard.world import HORIZON


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
        assert 0.5 * NOISE < np.abs(found - actions).max() < 2.0 * NOISE
    noise = Disturbed(Sine(0.0), 0).start(seeds)(observations)
    assert 0.99 * NOISE < np.abs(noise).max() <= NOISE
    assert noise.std() == pytest.approx(NOISE / np.sqrt(3.0), rel=0.05)


@pytest.mark.usefixtures("world")
def test_chaos_is_told_from_order():
    stable, chaotic = (measure(find_candidate(name), HORIZON) for name in ("bold", "twitch"))
    assert measure(find_candidate("twitch"), HORIZON) == chaotic
    assert stable["high"] - stable["low"] < 1e-5
    assert chaotic["high"] - chaotic["low"] > 0.1
