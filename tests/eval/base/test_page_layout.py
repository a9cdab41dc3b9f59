"""What every page shares: nothing is wider than a phone, tables scroll by themselves, text is legible."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from inclined_landing.eval.base.claims import Claim, Section, Table
from inclined_landing.eval.base.page import embedded, png
from inclined_landing.eval.gap.report.page import page as gap_page
from tests.eval.base.test_pages import claims_page, identification_page
from tests.eval.gap.test_report import example

PHONE = 390  # CSS pixels
LEAST = 14  # CSS pixels of text
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
# A frame as wide as a phone tells how wide its page is, how far table and picture in it scroll, the smallest
# text, and how far the first figure scrolls once it is tapped.
FRAME = """<iframe src="page.html" style="border:0;width:{width}px;height:900px"></iframe>
<pre id="seen"></pre>
<script>document.querySelector("iframe").onload = event => {{
  const page = event.target.contentDocument, size = element => [element.clientWidth, element.scrollWidth];
  const texts = page.createTreeWalker(page.body, NodeFilter.SHOW_TEXT), small = [];
  while (texts.nextNode()) {{
    const one = texts.currentNode.parentElement, {{fontSize}} = getComputedStyle(one);
    if (texts.currentNode.textContent.trim() && one.getClientRects().length && parseFloat(fontSize) < {least})
      small.push(one.tagName + " " + one.className + " " + fontSize);
  }}
  const parts = [...page.querySelectorAll(".wide")].map(size);
  const seen = {{page: size(page.scrollingElement), parts, small}};
  const figure = page.querySelector(".drawn");
  if (figure) {{ figure.focus(); seen.tapped = size(figure); }}
  document.getElementById("seen").textContent = JSON.stringify(seen);
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


PAGES = {
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


@pytest.mark.browser
def test_a_page_of_claims_fits_a_phone(tmp_path):
    figure = Figure(figsize=(10, 3))
    figure.subplots().plot(np.arange(5))
    heads = tuple(f"a column named {k}" for k in range(14))
    words = "a claim that is as long as claims are, and has a reason of some length besides"
    section = Section("one", "A section", words, [Claim(words, 1.0, 2.0, "m", words * 3)])
    section.tables = [Table("rows", heads, [tuple(range(14))]), Table("small", ("a", "b"), [(1, 2)])]
    section.figures = {"one.png": words}
    run, version = "landing-eval " + "x" * 80, "a_version_that_is_never_broken_" * 2
    page = claims_page([section], "A title", words, run, version, **{"one.png": embedded(png(figure))})
    (tmp_path / "page.html").write_text(page, "utf-8")
    seen = phone(tmp_path)
    assert seen["page"] == [PHONE, PHONE] and seen["small"] == []
    scrolls = [inside > outside for outside, inside in seen["parts"]]
    # The picture, whole until it is tapped; the table of 14 columns, the small one, the claims with reasons.
    assert scrolls == [False, True, False, True]
    assert seen["tapped"][1] > 2 * seen["tapped"][0]
