import json
import math
import os
from pathlib import Path

import numpy as np
import pytest

from capsule_gym.files import add_name_to_errors, replacing, synchronise, to_json, write_atomically


def lowest_free_descriptor():
    """The descriptor of the next file; it grows if a file stays open."""
    with open(os.devnull, "rb") as file:
        return file.fileno()


def test_a_file_replaces_what_was_there_whole_or_not_at_all(tmp_path, monkeypatch):
    path, synchronised = tmp_path / "result.json", []
    monkeypatch.setattr(
        os, "fsync", lambda descriptor: synchronised.append(os.fstat(descriptor).st_ino)
    )
    free = lowest_free_descriptor()
    for content, written in (("one", b"one"), ("zwölf\n", b"zw\xc3\xb6lf\n"), (b"\xff", b"\xff")):
        write_atomically(path, content)
        assert path.read_bytes() == written and synchronised[-1] == path.stat().st_ino
    synchronise(tmp_path)
    assert list(tmp_path.iterdir()) == [path] and synchronised[-1] == tmp_path.stat().st_ino
    assert lowest_free_descriptor() <= free
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


def test_json_has_null_where_a_number_is_not_finite():
    value = {
        "a": [1.0, math.inf, (math.nan, np.float64(-math.inf))],
        "b": {"c": 0.1, "d": None, "e": "nan"},
    }
    text = to_json(value)
    assert json.loads(text) == {
        "a": [1.0, None, [None, None]],
        "b": {"c": 0.1, "d": None, "e": "nan"},
    }
    assert text.endswith("}\n")
