"""Random changes of the files that the packages read: an error names the file, or it is read.

`make fuzz` tries many. Policy files are changed by `tests/capsule_gym/policies/test_fuzz.py`.
"""

import io
import json
import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.leaderboard.rows import RESULTS, load_row
from agents.training.config import CONFIG, PPOConfig, read_config
from baselines.dynamic_programming.archive import ARCHIVE, ARRAYS, FOLDER, load_archive
from capsule_gym import Fit
from capsule_gym.evaluation.sets import load_set
from tests.agents.rig import make_fit
from tests.capsule_gym.policies.test_fuzz import json_values

SET = {
    "name": "own",
    "capsule": {"static_ratio": 1.3},
    "disturbances": {"latency": [0.005, 0.015]},
    "plants": [
        {"M": 0.5, "mu": 0.01, "seed": 1, "changes": [{"t": 1.0, "M": 0.6, "mu": 0.02}]},
        {"M": 0.4, "mu": 0.02, "seed": 2, "theta": 0.3},
    ],
}
ROW = "pd.npz"
READERS = {
    "set.json": load_set,
    "fit.json": Fit.load,
    CONFIG: lambda path: read_config(path.parent),
    ROW: load_row,
    ARCHIVE: lambda path: load_archive(path.parent),
    ARRAYS: lambda path: load_archive(path.parent),
}
arrays = st.builds(
    np.zeros,
    st.lists(st.sampled_from([0, 1, 2, 17, 100]), max_size=3),
    st.sampled_from(["<f4", "<f8", ">f4", "u1", "?", "S3", "U2", "c8", "M8[s]"]),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a valid file for each reader."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "set.json").write_text(json.dumps(SET), encoding="utf-8")
    make_fit().save(folder / "fit.json")
    config = {"task": "residual", "algo": "ppo", "hyperparameters": PPOConfig().to_dict()}
    (folder / CONFIG).write_text(json.dumps(config), encoding="utf-8")
    shutil.copy(RESULTS / ROW, folder)
    for name in (ARCHIVE, ARRAYS):
        shutil.copy(FOLDER / name, folder)
    return folder


def check(path, content):
    """Checks the reading of a changed file, which is restored."""
    whole = path.read_bytes()
    path.write_bytes(content)
    try:
        READERS[path.name](path)
    except ValueError as error:
        assert str(path.parent) in str(error) or path.stem in str(error)
        assert len(str(error)) < 4000
    finally:
        path.write_bytes(whole)


@pytest.mark.parametrize("name", READERS)
@given(edits=st.lists(st.tuples(st.integers(0, 2**20), st.integers(0, 255)), max_size=5))
def test_changed_bytes(name, edits, folder):
    changed = bytearray((folder / name).read_bytes())
    for place, value in edits:
        changed[place % len(changed)] = value
    check(folder / name, bytes(changed))


def change(draw, value):
    """Replaces one part of a JSON value, or all of it."""
    inside = isinstance(value, (dict, list)) and value and draw(st.booleans())
    if not inside:
        return draw(json_values)
    keys = list(value) if isinstance(value, dict) else range(len(value))
    key = draw(st.sampled_from(keys))
    changed = value.copy()
    changed[key] = change(draw, value[key])
    return changed


@pytest.mark.parametrize("name", [name for name in READERS if name.endswith(".json")])
@given(data=st.data())
def test_changed_values(name, data, folder):
    content = json.loads((folder / name).read_text(encoding="utf-8"))
    changed = change(data.draw, content)
    check(folder / name, json.dumps(changed).encode())


@given(data=st.data(), changes=st.dictionaries(st.sampled_from(["header", "paper"]), arrays))
def test_changed_results(data, changes, folder):
    with np.load(folder / ROW) as archive:
        content = dict(archive)
    header = change(data.draw, json.loads(content["header"].tobytes()))
    content["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    content.update(changes)
    file = io.BytesIO()
    np.savez(file, **content)
    check(folder / ROW, file.getvalue())
