"""Pages escape every name from outside: their templates can do nothing else, and filled ones do not."""

import re
from pathlib import Path

import jinja2
import jinja2.meta
import pytest
from jinja2 import nodes
from pages import EVIL, check_page

from inclined_landing import eval as rooms
from inclined_landing.eval.base import page as base_page
from inclined_landing.eval.base.claims import Claim, Section
from inclined_landing.eval.gap.answer.identify import Identification, Identified
from inclined_landing.eval.gap.report import identified
from inclined_landing.models.parameters import load_vehicle

ROOM = Path(rooms.__path__[0])
TEMPLATES = sorted(path.relative_to(ROOM).as_posix() for path in ROOM.rglob("*.html.j2"))
UNESCAPED = {"safe", "forceescape", "xmlattr", "tojson"}  # filters that write markup, or other than text
IN_STYLE = {"{{ super() }}", "{{ paper }}"}  # of the program, not from outside


def test_there_are_templates():
    assert len(TEMPLATES) >= 8 and "base/page.html.j2" in TEMPLATES


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_cannot_write_markup_from_outside(name):
    text = (ROOM / name).read_text("utf-8")
    tree = jinja2.Environment(extensions=[]).parse(text)
    assert not {found.name for found in tree.find_all(nodes.Filter)} & UNESCAPED
    assert not list(tree.find_all(nodes.ScopedEvalContextModifier)) and "autoescape" not in text
    inside = "".join(re.findall(r"<style.*?</style>|{% block style %}.*?{% endblock %}", text, re.DOTALL))
    assert set(re.findall(r"{{.*?}}", inside)) <= IN_STYLE
    assert not re.search(r"<script[^>]*>[^<]*{{", text), "an expression in a script"
    plain = re.sub(r"{%.*?%}|{#.*?#}", "", text, flags=re.DOTALL)
    assert not re.search(r"""<[a-z][^<>]*=\s*{{""", plain), "an attribute without quotes"
    assert not re.search(r"""\bon[a-z]+\s*=\s*["'][^"']*{{""", plain), "an expression in an event handler"


def test_pages_are_filled_in_by_one_function_alone():
    """Other rooms may fill templates in, of texts and code, which need no escapes of HTML."""
    engine = re.compile(r"jinja2|Markup\(|markupsafe")
    files = {
        p.relative_to(ROOM).as_posix() for p in ROOM.rglob("*.py") if engine.search(p.read_text("utf-8"))
    }
    assert "base/page.py" in files
    for file in files - {"base/page.py"}:
        assert not list((ROOM / file).parent.rglob("*.html*")), f"{file} fills pages in by itself"


def test_the_page_of_claims():
    claim = Claim(f"{EVIL} claim", 1.0, 0.5, f"{EVIL} unit", f"{EVIL} why")
    section = Section(key="a", title=f"{EVIL} section", text=[f"{EVIL} text"], claims=[claim])
    html = base_page.claims_page(
        f"{EVIL} title",
        f"{EVIL} lead",
        [section],
        {},
        run=f"{EVIL} run",
        versions={"python": f"{EVIL} version"},
    )
    words = ("claim", "unit", "why", "section", "text", "lead", "run", "version")
    check_page(html, *(f"{EVIL} {word}" for word in words))


def test_the_page_of_identification():
    row = Identified(
        f"{EVIL} name", "body_mass", "kg", 0.033, 0.034, (0.033, 0.035), (0.034,), 0.0, f"{EVIL} said"
    )
    found = Identification(
        load_vehicle(),
        (row,),
        {"x": {"before": 50.0, "after": 90.0}},
        {},
        {},
        (f"{EVIL} flight",),
        (f"{EVIL} note",),
    )
    html = identified.page(found, heldout=(f"{EVIL} heldout",), seconds=1.0, versions={"python": "3"})
    check_page(html, *(f"{EVIL} {word}" for word in ("name", "said", "flight", "note", "heldout")))


def test_the_check_finds_what_runs():
    for bad in ("<script>1</script>", "<img src=x onerror=1>", '<a href="javascript:1">', '<p onclick="1">'):
        with pytest.raises(AssertionError, match="runs or loads"):
            check_page(f"<p>a</p>{bad}")
    with pytest.raises(AssertionError, match="does not show"):
        check_page("<p>a</p>", "b")
