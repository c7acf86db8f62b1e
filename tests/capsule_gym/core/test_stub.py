"""The types of the compiled core, which type checkers and editors read."""

import ast
from pathlib import Path

from capsule_gym.core import _core
from capsule_gym.core.stub import main, write_types


def test_the_build_writes_the_types_of_its_module(tmp_path):
    module = Path(_core.__file__)
    main(str(module), str(tmp_path / "types.pyi"))
    assert (tmp_path / "types.pyi").read_text() == module.with_name("_core.pyi").read_text()


def test_the_types_contain_every_constant_and_every_row():
    statements = ast.parse(write_types(_core)).body
    constants = [each.target.id for each in statements if isinstance(each, ast.AnnAssign)]
    assert constants == sorted(name for name in vars(_core) if name.isupper())
    (row,) = (each for each in statements if getattr(each, "name", "") == "Row")
    found = {each.target.id: ast.literal_eval(each.value) for each in row.body}
    assert found == {name: getattr(_core.Row, name) for name in _core.ROW_NAMES}
