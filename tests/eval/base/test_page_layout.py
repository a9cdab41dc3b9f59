"""What every page shares: nothing is wider than a phone, tables and pictures scroll by themselves."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import inclined_landing.eval
from inclined_landing.eval.base.claims import Claim, Section, Table
from inclined_landing.eval.base.page import claims_page, png

ROOMS = Path(inclined_landing.eval.__file__).parent
PHONE = 390  # CSS pixels
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
# A frame as wide as a phone tells how wide its page is, and how far table and picture in it scroll.
FRAME = """<iframe src="page.html" style="border:0;width:{width}px;height:900px"></iframe>
<pre id="seen"></pre>
<script>document.querySelector("iframe").onload = event => {{
  const page = event.target.contentDocument, size = element => [element.clientWidth, element.scrollWidth];
  document.getElementById("seen").textContent = JSON.stringify(
    {{page: size(page.scrollingElement), parts: [...page.querySelectorAll(".wide")].map(size)}});
}}</script>"""


def test_tables_and_pictures_of_all_templates_scroll():
    found = 0
    for template in ROOMS.rglob("*.j2"):
        text = template.read_text("utf-8")
        wide = re.findall(r'<div class="wide" tabindex="0"><(table|img)', text)
        assert len(wide) == len(re.findall(r"<(?:table|img)\b", text)), template.name
        found += len(wide)
    assert found >= 5


@pytest.mark.browser
def test_a_page_fits_a_phone(tmp_path):
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    figure = Figure(figsize=(10, 3))
    figure.subplots().plot(np.arange(5))
    heads = tuple(f"a column named {k}" for k in range(14))
    words = "a claim that is as long as claims are, and has a reason of some length besides"
    section = Section("one", "A section", words, [Claim(words, 1.0, 2.0, "m", words * 3)])
    section.tables = [Table("rows", heads, [tuple(range(14))]), Table("small", ("a", "b"), [(1, 2)])]
    section.figures = {"one.png": words}
    versions = {"a_name_that_is_never_broken_" * 2: "1.0"}
    given = {"images": {"one.png": png(figure)}, "run": "landing-eval " + "x" * 80, "versions": versions}
    (tmp_path / "page.html").write_text(claims_page("A title", words, [section], **given), "utf-8")
    (tmp_path / "frame.html").write_text(FRAME.format(width=PHONE), "utf-8")
    quiet = "--headless --no-sandbox --disable-gpu --no-first-run --disable-sync --hide-scrollbars"
    options = [*quiet.split(), "--allow-file-access-from-files", f"--user-data-dir={tmp_path / 'profile'}"]
    address = (tmp_path / "frame.html").as_uri()
    dumped = subprocess.run(
        [CHROMIUM, *options, "--virtual-time-budget=4000", "--dump-dom", address],
        capture_output=True, text=True, timeout=120, env=os.environ | {"HOME": str(tmp_path)},
    )  # fmt: skip
    found = re.search(r'<pre id="seen">(.*?)</pre>', dumped.stdout)
    assert found, dumped.stderr[-500:]
    seen = json.loads(found[1])
    assert seen["page"] == [PHONE, PHONE]
    scrolls = [inside > outside for outside, inside in seen["parts"]]
    # The picture, the table of 14 columns, the small one, the claims with their derivation.
    assert scrolls == [True, True, False, True]
