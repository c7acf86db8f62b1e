"""Pages and docstrings work as printed: examples run, commands and options exist.

`.ci/pages.py` runs the blocks of the pages with the installed package.
"""

import ast
import contextlib
import doctest
import importlib
import importlib.util
import io
import re
import runpy
import shlex
from collections import Counter
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import pytest

from tests import ROOT


def find(*patterns):
    """The files with these paths from the project's folder."""
    return sorted(path for pattern in patterns for path in ROOT.glob(pattern))


PAGES = find("*.md", "docs/**/*.md", "capsule_gym/**/*.md", "agents/**/*.md")
MODULES = find("capsule_gym/**/*.py", "baselines/**/*.py", "agents/**/*.py")
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


class Block(NamedTuple):
    """A fenced block: its file, the lines before its code, and its language."""

    path: Path
    line: int
    language: str
    code: str


def place(path, line):
    return f"{path.relative_to(ROOT).as_posix()}:{line}"


def module_name(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def texts(path):
    """A page, or the docstrings of a module; each with the number of lines before it."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        yield 0, text
        return
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            continue
        if ast.get_docstring(node):
            literal = node.body[0]
            before = literal.lineno - 1
            yield before, "\n".join(lines[before : literal.end_lineno])


def find_blocks():
    """Every fenced block of the pages and modules."""
    for path in (*PAGES, *MODULES):
        for first, text in texts(path):
            for match in FENCE.finditer(text):
                indent, language, code = match.groups()
                code = re.sub(f"^{indent}", "", code, flags=re.MULTILINE)
                line = first + text.count("\n", 0, match.start(3))
                yield Block(path, line, language, code)


def find_commands():
    """Every line of the blocks of a shell, with its place."""
    for block in BLOCKS:
        if block.language not in SHELL:
            continue
        lines = block.code.replace("\\\n", "").splitlines()
        for number, line in enumerate(lines, block.line + 1):
            if line.strip() and not line.lstrip().startswith("#"):
                yield pytest.param(line, id=place(block.path, number))


BLOCKS = list(find_blocks())
WITH_EXAMPLES = [path for path in MODULES if any(">>> " in text for _, text in texts(path))]


def test_every_block_is_in_a_language_that_is_checked():
    assert [block for block in BLOCKS if block.language not in KNOWN] == []


def test_every_fence_belongs_to_a_block():
    counts = Counter(block.path for block in BLOCKS)
    for path in PAGES:
        fences = re.findall(r"^ *(?:```|~~~)", path.read_text(encoding="utf-8"), re.MULTILINE)
        assert len(fences) == 2 * counts[path], path


def test_every_row_belongs_to_a_table_with_headings():
    for path in PAGES:
        lines = ["", *path.read_text(encoding="utf-8").splitlines(), ""]
        for before, line, after in zip(lines, lines[1:], lines[2:], strict=False):
            row = line.startswith("|") and line.endswith("|")
            if row and not before.startswith("|"):
                assert re.fullmatch(r"\|(:?-+:?\|)+", after), f"{path.name}: {line}"


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=module_name)
def test_examples_give_what_they_show(path):
    module = importlib.import_module(module_name(path))
    found = doctest.testmod(module, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    assert found.attempted > 0
    assert found.failed == 0


@cache
def help_of(name, *words):
    """The output of `--help` of a module after these words."""
    spec = importlib.util.find_spec(name)
    assert spec is not None, f"there is no module {name}"
    if spec.submodule_search_locations:
        name = f"{name}.__main__"
    module = importlib.import_module(name)
    out = io.StringIO()
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit):
        module.main([*words, "--help"])
    return out.getvalue()


def makefile_targets():
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    return set(re.findall(r"^([\w-]+):", text, re.MULTILINE))


def extras():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    _, _, tables = text.partition("[project.optional-dependencies]\n")
    table, _, _ = tables.partition("\n[")
    return set(re.findall(r"^([\w-]+) = ", table, re.MULTILINE))


@pytest.mark.parametrize("line", list(find_commands()))
def test_commands_and_their_options_exist(line):
    # Takes the body of a loop, without environment variables.
    line = re.sub(r"^for \w+ in .*?; do (.*?)[;&] *done.*$", r"\1", line)
    line = re.sub(r"^(\w+=\S* )+", "", line)
    program, *words = shlex.split(line, comments=True)
    program = Path(program).name
    if program == "make":
        targets = {word for word in words if "=" not in word}
        assert targets <= makefile_targets()
    elif program == "pip":
        for names in re.findall(r"\[([\w,-]+)\]", line):
            assert set(names.split(",")) <= extras()
    elif program.startswith("python"):
        check_call_of_python(words)
    else:
        assert program in ELSEWHERE


def check_call_of_python(words):
    """Fails if a module or script, or one of its options, does not exist."""
    given = {word.split("=")[0] for word in words if word.startswith("--")}
    options = given - {"--help"}
    script, *rest = words
    if script == "-m":
        module = rest[0]
        known = options if module in MODULES_ELSEWHERE else help_of(module)
    elif script == "train.py":
        # The help shows an algorithm's options only for that algorithm.
        chosen = [word for before, word in pairwise(words) if "--algo" in (before, word)]
        known = help_of("train", *chosen)
    else:
        assert (ROOT / script).exists()
        return
    assert [option for option in options if option not in known] == []


@pytest.fixture
def hooks():
    """The hooks of mkdocs."""
    pytest.importorskip("mkdocs")
    return SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "hooks.py")))


def page(source):
    """A page of mkdocs."""
    return SimpleNamespace(file=SimpleNamespace(src_uri=source), url="leaderboard/")


def table(*policies):
    return TABLE.format("".join(ROW.format(policy) for policy in policies))


RANKING = table("<strong>Learned</strong>", "direct-ppo", "adaptive")


def test_a_ranking_links_to_the_live_page(hooks):
    linked = hooks.on_page_content(RANKING, page("leaderboard.md"))
    assert re.findall(r'href="([^"]*)"', linked) == [
        "../live/index.html#driver=direct-ppo&amp;rival=adaptive&amp;set=paper&amp;plant=0",
        "../live/index.html#driver=adaptive&amp;set=paper&amp;plant=0",
    ]


@pytest.mark.parametrize(
    ("ranking", "source"), [(table("nobody"), "leaderboard.md"), (RANKING, "evidence.md")]
)
def test_unknown_policies_and_other_pages_have_no_links(ranking, source, hooks):
    assert hooks.on_page_content(ranking, page(source)) == ranking


def test_a_scene_links_to_the_live_page(hooks):
    text = "See [it](live.md#driver=epc&M=0.5&t=2), [live](live.md)."
    link = '<a href="../live/index.html#driver=epc&amp;M=0.5&amp;t=2">it</a>'
    found = hooks.on_page_markdown(text, page("leaderboard.md"))
    assert found == f"See {link}, [live](live.md)."


def test_a_scene_with_an_unknown_policy_raises_an_error(hooks):
    with pytest.raises(Exception, match="lacks: nobody"):
        hooks.on_page_markdown("[it](live.md#driver=epc&rival=nobody)", page("leaderboard.md"))
