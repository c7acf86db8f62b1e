import numpy as np

from agents.training.loop import make_env
from agents.training.runs import Normalisation
from tests.agents.training.small import small


def test_saved_normalisation_is_the_one_that_sb3_applies(tmp_path):
    env = make_env(small("direct", "ppo"), 0)
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(50):
        env.step(rng.uniform(-1, 1, (8, 1)).astype(np.float32))
    Normalisation.of(env).write(tmp_path / "n.json")
    raw = env.get_original_obs()
    np.testing.assert_allclose(Normalisation.read(tmp_path / "n.json")(raw), env.normalize_obs(raw), rtol=1e-6)
    env.close()
