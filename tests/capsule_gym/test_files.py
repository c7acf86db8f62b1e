import io
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest

from capsule_gym.files import (
    add_name_to_errors,
    load_arrays,
    replacing,
    synchronise,
    to_json,
    write_atomically,
)


def lowest_free_descriptor():
    """The descriptor of the next file; it grows if a file stays open."""
    with open(os.devnull, "rb") as file:
        return file.fileno()


@pytest.fixture
def synchronised(monkeypatch):
    """The inodes that have been written to the disk."""
    inodes = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: inodes.append(os.fstat(descriptor).st_ino))
    return inodes


@pytest.mark.parametrize(
    ("content", "written"), [("one", b"one"), ("zwölf\n", b"zw\xc3\xb6lf\n"), (b"\xff", b"\xff")]
)
def test_a_file_replaces_what_was_there(content, written, tmp_path, synchronised):
    path = tmp_path / "result.json"
    path.write_text("old")
    free = lowest_free_descriptor()

    write_atomically(path, content)

    assert path.read_bytes() == written
    assert synchronised[-1] == path.stat().st_ino
    assert list(tmp_path.iterdir()) == [path]
    assert lowest_free_descriptor() <= free


def test_the_names_in_a_folder_are_synchronised(tmp_path, synchronised):
    free = lowest_free_descriptor()
    synchronise(tmp_path)
    assert synchronised == [tmp_path.stat().st_ino]
    assert lowest_free_descriptor() <= free


def test_a_file_stays_as_it_was_after_an_error(tmp_path):
    path = tmp_path / "result.json"
    write_atomically(path, "old")
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        assert (temporary.suffix, temporary.parent) == (".json", tmp_path)
        temporary.write_text("half", encoding="utf-8")
        assert path.read_text(encoding="utf-8") == "old"
        raise RuntimeError
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("error", "named"), [((28, "failed"), "run"), ((2, "failed", "b"), "b"), (("failed",), None)]
)
def test_an_error_of_the_system_names_a_file(error, named):
    with pytest.raises(OSError, match="failed") as caught, add_name_to_errors(Path("run")):
        raise OSError(*error)
    assert caught.value.filename == named


@pytest.mark.parametrize(
    ("value", "found"),
    [
        ([1.0, math.inf, (math.nan, np.float64(-math.inf))], [1.0, None, [None, None]]),
        ({"c": 0.1, "d": None, "e": "nan"}, {"c": 0.1, "d": None, "e": "nan"}),
    ],
)
def test_json_has_null_where_a_number_is_not_finite(value, found):
    assert json.loads(to_json({"a": value})) == {"a": found}


def test_json_ends_with_a_line_break():
    assert to_json({"a": 1.0}).endswith("}\n")


def saved(save, value):
    """The bytes that a function of numpy writes."""
    content = io.BytesIO()
    save(content, value)
    return content.getvalue()


ARRAYS = saved(np.savez, np.arange(3))


def test_the_arrays_of_a_file_are_read(tmp_path):
    path = tmp_path / "arrays.npz"
    path.write_bytes(ARRAYS)
    arrays = load_arrays(path)
    assert arrays.keys() == {"arr_0"}
    np.testing.assert_array_equal(arrays["arr_0"], [0, 1, 2])


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(b"", id="empty"),
        pytest.param(b"speed,cost\n", id="text"),
        pytest.param(ARRAYS[:-30], id="truncated"),
        pytest.param(ARRAYS.replace(b"'descr'", b"'descr("), id="changed header"),
        pytest.param(saved(np.save, np.arange(3)), id="one array"),
        pytest.param(saved(np.savez, np.array([None])), id="pickled"),
    ],
)
def test_a_malformed_file_of_arrays_is_named(content, tmp_path):
    path = tmp_path / "arrays.npz"
    path.write_bytes(content)
    free = lowest_free_descriptor()
    with pytest.raises(ValueError, match=r"arrays\.npz must be a file of numpy\.savez, got "):
        load_arrays(path)
    assert lowest_free_descriptor() <= free


def test_a_missing_file_of_arrays_is_not_malformed(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_arrays(tmp_path / "arrays.npz")
