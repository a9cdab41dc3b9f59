"""Figures on pages for users stand in the records that the pages name.

After a paragraph or table an HTML comment, which readers do not see, has one line for each record:

    <!-- records
    99.1 %, 28.2 %: docs/evidence/landing.md 0.5 28.2 % [25.1, 31.5] 99.1 %
    -->

The line has the figures of the text above it, the file that records them, where needed `#` and the heading
of the section, and the words of the record, without the bars and stars of Markdown; `...` is a gap.
"""

import re

import pytest

from inclined_landing.models.base import storage
from tests import ROOT, documents

PAGES = ("README.md", "docs/results.md", "docs/trust.md")
GUIDES = [name for name in documents.documents() if re.match("docs/(guides/|faq|quickstart)", name)]
# Of guides, not measured: the stopping rule of training, the levels of intervals and quantiles.
DEFINED = ("99 %", "95 %", "5 %")
COMMENT = re.compile(r"<!-- records\n(.*?)-->", re.DOTALL)
LINE = re.compile(r"(?P<figures>[^:]+): (?P<file>[\w/.-]+)(?:#(?P<section>\S+))? (?P<words>.+)")
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.]*\d)")
SHARE = re.compile(r"\d[\d.]* %|\d+ of \d+")


def plain(text: str) -> str:
    return " ".join(re.sub(r"[|*]", " ", text).split())


def section(text: str, heading: str | None) -> str:
    if not heading:
        return text
    _, begins, rest = text.partition(f"\n## {heading}\n")
    assert begins, f"no heading {heading}"
    return rest.partition("\n## ")[0]


def pieces(text: str) -> list[tuple[str, str]]:
    """The texts of a page, each with the records after it; the last has none."""
    parts = COMMENT.split(documents.FENCE.sub("", text))
    return list(zip(parts[::2], [*parts[1::2], ""], strict=True))


def faults(text: str) -> list[str]:
    """What is wrong with the figures of a page."""
    found = []
    for words, comment in pieces(text):
        words, named = plain(words), set()
        for line in comment.splitlines():
            match = LINE.fullmatch(line)
            assert match, f"not a record: {line}"
            wanted = plain(match["words"])
            recorded = plain(section((ROOT / match["file"]).read_text("utf-8"), match["section"]))
            if not re.search(".*".join(map(re.escape, wanted.split(" ... "))), recorded):
                found.append(f"not in {match['file']}: {wanted}")
            for figure in match["figures"].split(", "):
                named.add(figure)
                if not re.search(rf"(?<![\w.]){re.escape(figure)}(?![\w.]*\d)", words):
                    found.append(f"not on the page: {figure}")
                if missing := set(NUMBER.findall(figure)) - set(NUMBER.findall(wanted)):
                    found.append(f"{match['file']} says something else: {line}, {missing}")
        found += [f"without a record: {share}" for share in SHARE.findall(words) if share not in named]
    return found


@pytest.mark.parametrize("name", [*PAGES, *sorted(GUIDES)])
def test_every_share_has_a_record_that_says_the_same(name):
    text = (ROOT / name).read_text("utf-8")
    defined = [f"without a record: {share}" for share in DEFINED if name in GUIDES]
    assert not [fault for fault in faults(text) if fault not in defined]
    assert name in GUIDES or sum(comment.count("\n") for _, comment in pieces(text)) > 5


def test_the_rows_of_the_loops_are_those_of_their_record():
    evidence = ROOT / "docs/evidence"
    teaching, planned = (
        plain((evidence / name).read_text("utf-8")) for name in ("teaching.md", "planned_flights.md")
    )
    for one in storage.read_toml(evidence / "teaching.toml", "record")["loops"]:
        before, after = one["grid"]
        seed = one["seed"]
        pairs = " ".join("{}, {}".format(*one[key]) for key in ("clean", "rest"))
        assert f" {seed} {before} of 251, {after} of 251 {pairs} " in teaching
        assert " {} {:.2f} {:.2f} ".format(seed, *one["body_drag"]) in planned


def test_the_rows_of_flights_are_those_of_their_record():
    page = plain((ROOT / "docs/evidence/flying.md").read_text("utf-8"))
    record = storage.read_toml(ROOT / "docs/evidence/flying.toml", "record")
    assert f"{record['faults']['safe']} of 63 are safe" in page
    for one in record["runs"]:
        name = f"`{one['policy']}`, {one['vehicle']} vehicle, seed {one['seed']} {one['clean']} of 30"
        times = ["{:.2f} ({:.2f} to {:.2f})".format(*one[key]) for key in ("landing", "speed")]
        row = f"`{one['policy']}` {one['vehicle']} 100.0 %.* {' '.join(map(re.escape, times))}"
        assert name in page or (one["clean"] == 30 and re.search(row, page)), one
