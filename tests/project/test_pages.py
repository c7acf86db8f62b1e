"""Pages and docstrings work as printed: Python blocks and examples run, commands, options and
modules exist."""

import ast
import contextlib
import doctest
import importlib
import importlib.util
import io
import re
import runpy
import shlex
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    path
    for folder in ("*.md", "docs/**/*.md", "capsule_gym/**/*.md", "agents/**/*.md")
    for path in ROOT.glob(folder)
)
MODULES = sorted(
    path
    for package in ("capsule_gym", "baselines", "agents")
    for path in (ROOT / package).rglob("*.py")
)
FENCE = re.compile(r"^( *)```(\w+)\b[^\n]*\n(.*?)^\1```\s*$", re.DOTALL | re.MULTILINE)
SHELL = ("bash", "sh", "shell", "console")
# The JavaScript of docs/live.md runs in tests/web, the C of docs/export.md in
# tests/capsule_gym/export/test_export.py.
KNOWN = {"python", "c", "text", "js", *SHELL}
# Programs of other projects.
ELSEWHERE = {"gcc", "git", "bash", "cd", "tensorboard", "pre-commit", "pip", "venv", "uvx"}
MODULES_ELSEWHERE = {"pytest", "venv", "pip", "rl_zoo3.train"}
# Tables as mkdocs writes them.
TABLE = "<table>\n<tr>\n<th>policy</th>\n<th>senses</th>\n</tr>\n{}</table>"
ROW = "<tr>\n<td>{}</td>\n<td>stick</td>\n</tr>\n"


def texts(path):
    """The prose of a file with the number of lines before it: a page itself, or the docstrings of a
    module."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        yield 0, text
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(
            node
        ):
            literal = node.body[0]
            yield (
                literal.lineno - 1,
                "\n".join(text.splitlines()[literal.lineno - 1 : literal.end_lineno]),
            )


def blocks():
    """File, number of lines before it, language and code of every fenced block."""
    for path in (*PAGES, *MODULES):
        for first, text in texts(path):
            for match in FENCE.finditer(text):
                code = re.sub(f"^{match[1]}", "", match[3], flags=re.MULTILINE)
                line = first + text.count("\n", 0, match.start(3))
                yield path.relative_to(ROOT).as_posix(), line, match[2], code


BLOCKS = list(blocks())
PYTHON = [
    pytest.param(*block, id=f"{block[0]}:{block[1]}") for block in BLOCKS if block[2] == "python"
]
COMMANDS = [
    pytest.param(line, id=f"{name}:{first + n + 1}")
    for name, first, language, code in BLOCKS
    if language in SHELL
    for n, line in enumerate(code.replace("\\\n", "").splitlines())
    if line.strip() and not line.lstrip().startswith("#")
]
WITH_EXAMPLES = [path for path in MODULES if any(">>> " in text for _, text in texts(path))]


def test_every_block_is_in_a_language_that_is_checked():
    assert {block[:2]: block[2] for block in BLOCKS if block[2] not in KNOWN} == {}
    for path in PAGES:
        fences = re.findall(r"^ *(?:```|~~~)", path.read_text(encoding="utf-8"), re.MULTILINE)
        assert len(fences) == 2 * sum(
            block[0] == path.relative_to(ROOT).as_posix() for block in BLOCKS
        ), path


@pytest.mark.parametrize(("name", "line", "language", "code"), PYTHON)
def test_block_runs(name, line, language, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("MPLBACKEND", "agg")
    # A real file; padding gives it the line numbers of the page.
    script = tmp_path / f"{Path(name).stem}.py"
    script.write_text("\n" * line + code, encoding="utf-8")
    runpy.run_path(str(script), run_name="__main__")


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_examples_give_what_they_show(path):
    module = importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    found = doctest.testmod(module, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    assert found.attempted and not found.failed


@cache
def help_of(name, *words):
    """The output of `--help` of a module after these words."""
    spec = importlib.util.find_spec(name)
    assert spec is not None, f"there is no module {name}"
    module = importlib.import_module(
        f"{name}.__main__" if spec.submodule_search_locations else name
    )
    out = io.StringIO()
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit):
        module.main([*words, "--help"])
    return out.getvalue()


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_and_their_options_exist(line):
    # Takes the body of a loop, without environment variables.
    line = re.sub(r"^for \w+ in .*?; do (.*?)[;&] *done.*$", r"\1", line)
    words = shlex.split(re.sub(r"^(\w+=\S* )+", "", line), comments=True)
    program, rest = Path(words[0]).name, words[1:]
    options = {word.split("=")[0] for word in rest if word.startswith("--")} - {"--help"}
    if program == "make":
        targets = re.findall(
            r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
        )
        assert {word for word in rest if "=" not in word} <= set(targets)
    elif program == "pip":
        extras = (
            (ROOT / "pyproject.toml")
            .read_text(encoding="utf-8")
            .split("[project.optional-dependencies]")[1]
        )
        for name in re.findall(r"\[([\w,-]+)\]", line):
            assert all(re.search(f"^{each} = ", extras, re.MULTILINE) for each in name.split(","))
    elif not program.startswith("python"):
        assert program in ELSEWHERE
    elif rest[0] == "-m":
        assert (
            rest[1] in MODULES_ELSEWHERE
            or {each for each in options if each not in help_of(rest[1])} == set()
        )
    elif rest[0] == "train.py":
        # The help shows an algorithm's options only for that algorithm.
        chosen = [word for n, word in enumerate(rest) if "--algo" in (word, rest[n - 1])]
        assert {each for each in options if each not in help_of("train", *chosen)} == set()
    else:
        assert (ROOT / rest[0]).exists()


def test_rankings_and_scenes_link_to_the_live_page():
    pytest.importorskip("mkdocs")
    hooks = SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "hooks.py")))
    page = SimpleNamespace(file=SimpleNamespace(src_uri="leaderboard.md"), url="leaderboard/")
    rows = TABLE.format(
        "".join(map(ROW.format, ("<strong>Learned</strong>", "direct-ppo", "adaptive")))
    )
    assert re.findall(r'href="([^"]*)"', hooks.on_page_content(rows, page)) == [
        "../live/index.html#driver=direct-ppo&amp;rival=adaptive&amp;set=paper&amp;plant=0",
        "../live/index.html#driver=adaptive&amp;set=paper&amp;plant=0",
    ]
    absent = TABLE.format(ROW.format("nobody"))
    assert hooks.on_page_content(absent, page) == absent
    found = hooks.on_page_markdown("See [it](live.md#driver=epc&M=0.5&t=2), [live](live.md).", page)
    assert (
        found
        == 'See <a href="../live/index.html#driver=epc&amp;M=0.5&amp;t=2">it</a>, [live](live.md).'
    )
    with pytest.raises(Exception, match="lacks: nobody"):
        hooks.on_page_markdown("[it](live.md#driver=epc&rival=nobody)", page)
    page.file.src_uri = "evidence.md"
    assert hooks.on_page_content(rows, page) == rows
