"""What the pages and docstrings show works as it is printed: Python blocks and examples run, commands exist."""

from __future__ import annotations

import ast
import contextlib
import doctest
import importlib
import importlib.util
import io
import re
import runpy
import shlex
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("agents/**/*.md")])
MODULES = sorted(path for package in ("capsule_gym", "baselines", "agents") for path in (ROOT / package).rglob("*.py"))
FENCE = re.compile(
    r"^(?P<indent> *)```(?P<language>\w+)\b[^\n]*\n(?P<code>.*?)^(?P=indent)```\s*$", re.DOTALL | re.MULTILINE
)
# Programs of the venv, of the machine, or of the shell: there, and not this project's to test.
ELSEWHERE = {"git", "bash", "cd", "tensorboard", "pre-commit", "pip", "venv"}


class Block(NamedTuple):
    """A fenced block.

    Attributes:
        name: of its file, from the project's folder.
        line: lines of the file in front of the code.
        language: as the fence says it.
        code: without indentation.
    """

    name: str
    line: int
    language: str
    code: str


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """The prose of a file with the number of lines in front of it: a page itself, or the docstrings of a module."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        yield 0, text
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(node):
            literal = node.body[0]
            yield literal.lineno - 1, "\n".join(text.splitlines()[literal.lineno - 1 : literal.end_lineno])


def blocks(path: Path) -> Iterator[Block]:
    """The fenced blocks of a page, or of a module's docstrings."""
    name = path.relative_to(ROOT).as_posix()
    for first, text in texts(path):
        for match in FENCE.finditer(text):
            indent = len(match["indent"])
            code = "".join(line[indent:] or "\n" for line in match["code"].splitlines(keepends=True))
            yield Block(name, first + text.count("\n", 0, match.start("code")), match["language"], code)


BLOCKS = [block for path in (*PAGES, *MODULES) for block in blocks(path)]
PYTHON = [block for block in BLOCKS if block.language == "python"]
COMMANDS = [
    (f"{block.name}:{block.line + n + 1}", line)
    for block in BLOCKS
    if block.language in ("bash", "sh", "shell", "console")
    for n, line in enumerate(block.code.splitlines())
    if line.strip() and not line.lstrip().startswith("#")
]


def test_pages_show_examples() -> None:
    assert {"README.md", "docs/controllers.md", "capsule_gym/env.py"} <= {block.name for block in PYTHON}
    assert len(COMMANDS) > 20


def test_no_block_escapes() -> None:
    # What is in no known language, or fenced in another way, would be neither run nor checked.
    known = {"python", "bash", "sh", "shell", "console", "text"}
    # tests/web/test_capsule.py runs that page's.
    known_in = {"docs/live.md": known | {"js"}}
    unknown = [block for block in BLOCKS if block.language not in known_in.get(block.name, known)]
    assert {f"{block.name}:{block.line}": block.language for block in unknown} == {}
    fences = re.compile(r"^ *(?:```|~~~)", re.MULTILINE)
    for path in PAGES:
        found = len(list(blocks(path)))
        assert len(fences.findall(path.read_text(encoding="utf-8"))) == 2 * found, path.relative_to(ROOT)


@pytest.mark.parametrize("block", PYTHON, ids=[f"{block.name}:{block.line + 1}" for block in PYTHON])
def test_block_runs(block: Block, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("MPLBACKEND", "agg")
    # A real file, because compiled control laws read their own source; padded, so that line numbers are the page's.
    script = tmp_path / f"{Path(block.name).stem}.py"
    script.write_text("\n" * block.line + block.code, encoding="utf-8")
    runpy.run_path(str(script), run_name="__main__")


WITH_EXAMPLES = [path for path in MODULES if any(">>> " in text for _, text in texts(path))]


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_examples_give_what_they_show(path: Path) -> None:
    module = importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    found = doctest.testmod(module, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    assert found.attempted and not found.failed


def test_some_docstrings_have_examples() -> None:
    assert len(WITH_EXAMPLES) >= 4


# --- commands --------------------------------------------------------------------------------------------------------


@cache
def make_targets() -> set[str]:
    """The targets of the Makefile."""
    return set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


@cache
def extras() -> set[str]:
    """The optional dependencies of the package."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    section = text.split("[project.optional-dependencies]")[1].split("\n[")[0]
    return set(re.findall(r"^([\w-]+) = ", section, re.MULTILINE))


def check_command(words: list[str], help_of: Callable[[str], str]) -> None:
    """Refuses a command that does not exist, or an option that it does not have."""
    while words and re.fullmatch(r"\w+=.*", words[0]):
        words = words[1:]
    program, rest = Path(words[0]).name, words[1:]
    if program == "make":
        targets = [word for word in rest if "=" not in word]
        assert targets and set(targets) <= make_targets(), f"make {targets}"
    elif re.fullmatch(r"python(3(\.\d+)?)?", program):
        if rest[0] == "-m" and rest[1] not in ("pytest", "venv", "pip"):
            options = {word.split("=")[0] for word in rest[2:] if word.startswith("--")}
            missing = {option for option in options if option not in help_of(rest[1])}
            assert not missing, f"python -m {rest[1]} has no {missing}"
        elif rest[0] == "train.py":
            options = {word.split("=")[0] for word in rest[1:] if word.startswith("--")} - {"--help"}
            # The options of an algorithm are shown for that algorithm.
            chosen = [word for n, word in enumerate(rest) if "--algo" in (word, rest[n - 1])]
            missing = {option for option in options if option not in help_of(" ".join(["train", *chosen]))}
            assert not missing, f"train.py has no {missing}"
        elif rest[0] != "-m":
            assert (ROOT / rest[0]).exists(), rest[0]
    elif program == "pip":
        asked = {name for word in rest for group in re.findall(r"\[([\w,]+)\]", word) for name in group.split(",")}
        assert asked <= extras(), f"extras {asked - extras()}"
    else:
        assert program in ELSEWHERE, program


@pytest.fixture(scope="module")
def help_of() -> Callable[[str], str]:
    """What `--help` of a module prints; `train --algo sac` means train.py with these words."""

    @cache
    def printed(words: str) -> str:
        name, *more = words.split()
        spec = importlib.util.find_spec(name)
        assert spec is not None, f"there is no module {name}"
        module = importlib.import_module(f"{name}.__main__" if spec.submodule_search_locations else name)
        out = io.StringIO()
        with contextlib.redirect_stdout(out), pytest.raises(SystemExit) as end:
            module.main([*more, "--help"])
        assert end.value.code == 0
        return out.getvalue()

    return printed


@pytest.mark.parametrize(("where", "line"), COMMANDS, ids=[where for where, _ in COMMANDS])
def test_commands_exist(where: str, line: str, help_of: Callable[[str], str]) -> None:
    # A loop of the shell: its body counts.
    line = re.sub(r"^for \w+ in .*?; do (.*?)[;&] *done.*$", r"\1", line)
    check_command(shlex.split(line, comments=True), help_of)


MENTIONED = sorted({
    (path.relative_to(ROOT).as_posix(), module)
    for path in (*PAGES, *MODULES)
    for _, text in texts(path)
    for module in re.findall(r"python -m ([a-z][\w.]*\w)", text)
    if not (path.suffix == ".md" and path.name in ("CHANGELOG.md",))
})  # fmt: skip


@pytest.mark.parametrize(("where", "module"), MENTIONED, ids=[f"{where}-{module}" for where, module in MENTIONED])
def test_mentioned_modules_exist(where: str, module: str) -> None:
    # RL Zoo is an extra that the tests do not install.
    elsewhere = ("pytest", "venv", "pip", "rl_zoo3.train")
    assert module in elsewhere or importlib.util.find_spec(module), f"{where} names {module}"
