import re
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]
# Tables as mkdocs writes them.
TABLE = "<table>\n<tr>\n<th>policy</th>\n<th>senses</th>\n</tr>\n{}</table>"
ROW = "<tr>\n<td>{}</td>\n<td>stick</td>\n</tr>\n"


def test_rankings_and_scenes_link_to_the_live_page() -> None:
    pytest.importorskip("mkdocs")
    hooks = SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "hooks.py")))
    page = SimpleNamespace(file=SimpleNamespace(src_uri="leaderboard.md"), url="leaderboard/")
    rows = TABLE.format("".join(map(ROW.format, ("<strong>Learned</strong>", "direct-ppo", "adaptive"))))
    assert re.findall(r'href="([^"]*)"', hooks.on_page_content(rows, page)) == [
        "../live/index.html#driver=direct-ppo&amp;rival=adaptive&amp;set=paper&amp;plant=0",
        "../live/index.html#driver=adaptive&amp;set=paper&amp;plant=0",
    ]
    absent = TABLE.format(ROW.format("nobody"))
    assert hooks.on_page_content(absent, page) == absent
    found = hooks.on_page_markdown("See [it](live.md#driver=epc&M=0.5&t=2), [live](live.md).", page)
    assert found == 'See <a href="../live/index.html#driver=epc&amp;M=0.5&amp;t=2">it</a>, [live](live.md).'
    with pytest.raises(Exception, match="lacks: nobody"):
        hooks.on_page_markdown("[it](live.md#driver=epc&rival=nobody)", page)
    page.file.src_uri = "evidence.md"
    assert hooks.on_page_content(rows, page) == rows
