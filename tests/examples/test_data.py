"""The committed datasets are what the environment gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from examples import publish_data

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"
NAMES = ("adaptive", "residual-on-gait")


def test_the_datasets_are_small() -> None:
    files = [path for path in DATA.rglob("*") if path.is_file()]
    assert len(files) >= 2 * len(NAMES)
    assert sum(path.stat().st_size for path in files) < 2_000_000


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.filterwarnings("default")
def test_the_actions_give_the_episodes_again(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(DATA))
    dataset = minari.load_dataset(f"capsule/{name}-v0")
    assert dataset.total_episodes == 5
    env = dataset.recover_environment()
    for seed, episode in enumerate(dataset):
        observation, info = env.reset(seed=seed)
        seen, states = [observation], [info["state"]]
        for action in episode.actions:
            observation, _, terminated, truncated, info = env.step(action)
            seen.append(observation)
            states.append(info["state"])
        assert (terminated, truncated) == (False, True)
        assert np.array_equal(episode.observations, seen)
        assert np.array_equal(episode.infos["state"], states)


@pytest.mark.parametrize("missing", publish_data.NEEDED)
def test_without_minari_one_line_names_what_to_install(
    missing: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(publish_data, "find_spec", lambda name: None if name == missing else "found")
    assert publish_data.main() == 2
    error = capsys.readouterr().err
    assert 'pip install "capsule-gym[minari]"' in error and error.count("\n") == 1
