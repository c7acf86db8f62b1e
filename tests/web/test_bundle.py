"""Many modules become one file in which no name of one meets another's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from web import bundle

TEMPLATE = "<style>/* style */</style><script>/* script */</script>"


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to which a page's files are written."""
    monkeypatch.setattr(bundle, "PAGE", tmp_path)
    (tmp_path / "index.html").write_text(TEMPLATE, encoding="utf-8")
    (tmp_path / "page.css").write_text("body { color: var(--ink); }", encoding="utf-8")
    return tmp_path


def write(folder: Path, /, **modules: str) -> None:
    """Writes modules by their names."""
    for name, source in modules.items():
        (folder / f"{name}.js").write_text(source, encoding="utf-8")


def test_modules_stand_behind_what_they_import_and_once(page: Path) -> None:
    write(
        page,
        page='import { a } from "./a.js";\nimport { b as c } from "./b.js";\n',
        a='import { b } from "./b.js";\nexport const a = b;\n',
        b='import { drive } from "./capsule.mjs";\nexport async function b() {}\nexport class B {}\n',
    )
    built = bundle.bundle("export function drive() {}\n")
    assert re.findall(r'^modules\["(.*?)"\] =', built, re.MULTILINE) == ["capsule.mjs", "b.js", "a.js", "page.js"]
    assert 'const { b: c } = modules["b.js"];' in built
    assert "return { b, B };" in built
    assert "import" not in built
    assert "export" not in built


def test_colours_and_lengths_are_those_of_the_moving_picture(page: Path) -> None:
    write(page, page='import { figure } from "./figure.js";\n')
    built = bundle.bundle("")
    assert "--ink: #1e293b;" in built
    assert '"ROD": 168.0' in built


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ('import * as all from "./a.js";\n', "page.js must import as in"),
        ("export default 1;\n", "page.js must import as in"),
        ("export { a };\n", "page.js must import as in"),
        ('import { a } from "./page.js";\n', "in a circle, got page.js -> page.js"),
        ('const text = "</script>";\n', "must not contain '</script'"),
    ],
)
def test_other_forms_are_refused(page: Path, source: str, words: str) -> None:
    write(page, page=source)
    with pytest.raises(ValueError, match=re.escape(words)):
        bundle.bundle("")


def test_a_missing_module_is_named(page: Path) -> None:
    write(page, page='import { a } from "./gone.js";\n')
    with pytest.raises(FileNotFoundError, match=r"gone\.js"):
        bundle.bundle("")
