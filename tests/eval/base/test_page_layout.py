"""What every page shares: nothing is wider than a phone, text is legible."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from inclined_landing.eval.base.claims import Claim, Section, Table
from inclined_landing.eval.gap.report.page import page as gap_page
from tests.eval.base.test_pages import claims_page, identification_page
from tests.eval.gap.test_report import example

PHONE = 390  # CSS pixels
LEAST = 14  # CSS pixels of text
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
# A frame as wide as a phone tells how wide its page is, and which of its texts are small.
FRAME = """<iframe src="page.html" style="border:0;width:{width}px;height:900px"></iframe>
<pre id="seen"></pre>
<script>document.querySelector("iframe").onload = event => {{
  const page = event.target.contentDocument, {{clientWidth, scrollWidth}} = page.scrollingElement;
  const texts = page.createTreeWalker(page.body, NodeFilter.SHOW_TEXT), small = [];
  while (texts.nextNode()) {{
    const one = texts.currentNode.parentElement, {{fontSize}} = getComputedStyle(one);
    if (texts.currentNode.textContent.trim() && one.getClientRects().length && parseFloat(fontSize) < {least})
      small.push(one.tagName + " " + one.className + " " + fontSize);
  }}
  document.getElementById("seen").textContent = JSON.stringify({{page: [clientWidth, scrollWidth], small}});
}}</script>"""


def phone(folder: Path) -> dict:
    """Return what a browser as wide as a phone sees of page.html in a folder."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    (folder / "frame.html").write_text(FRAME.format(width=PHONE, least=LEAST), "utf-8")
    quiet = "--headless --no-sandbox --disable-gpu --no-first-run --disable-sync --hide-scrollbars"
    options = [*quiet.split(), "--allow-file-access-from-files", f"--user-data-dir={folder / 'profile'}"]
    dumped = subprocess.run(
        [CHROMIUM, *options, "--virtual-time-budget=4000", "--dump-dom", (folder / "frame.html").as_uri()],
        capture_output=True, text=True, timeout=120, env=os.environ | {"HOME": str(folder)},
    )  # fmt: skip
    found = re.search(r'<pre id="seen">(.+?)</pre>', dumped.stdout)
    assert found, dumped.stderr[-500:]
    return json.loads(found[1])


# Fourteen columns and words as long as claims have them.
CLAIM = Claim("a claim that is as long as claims are, with a reason", 1.0, 2.0, "m", "some words " * 30)
WIDE = Table("rows", tuple(f"a column named {k}" for k in range(14)), [tuple(range(14))])
PAGES = {
    "claims": lambda: claims_page(
        [Section("one", "A section", ["Text."], [CLAIM], tables=[WIDE])], "A title", "", "x" * 80, "y_" * 40
    ),
    "gap": lambda: gap_page(example("unknown"), None, versions={"python": "3"}),
    "identify": lambda: identification_page("a word"),
}


@pytest.mark.browser
@pytest.mark.parametrize("name", PAGES)
def test_every_page_fits_a_phone(name, tmp_path):
    (tmp_path / "page.html").write_text(PAGES[name](), "utf-8")
    seen = phone(tmp_path)
    assert seen["page"] == [PHONE, PHONE]
    assert seen["small"] == []
