"""Pages escape every name from outside: their templates can do nothing else, and filled ones do not."""

import json
import re
from pathlib import Path

import jinja2
import jinja2.meta
import pytest
from jinja2 import nodes

from inclined_landing import eval as rooms
from inclined_landing.eval.base.claims import Claim, Section
from inclined_landing.eval.base.page import of_sections
from inclined_landing.eval.gap.answer.identification import Identification, Identified
from inclined_landing.eval.gap.model.reference import VehiclePosterior
from inclined_landing.eval.gap.report import identified
from inclined_landing.eval.replay.page import _as_script
from inclined_landing.models.parameters import load_vehicle
from tests.pages import EVIL, check_page

ROOM = Path(rooms.__path__[0])
TEMPLATES = sorted(ROOM.rglob("*.html.j2"))
UNESCAPED = {"safe", "forceescape", "xmlattr", "tojson"}  # filters that write markup, or other than text
IN_STYLE = {"{{ super() }}", "{{ paper }}", "{{ style }}"}  # of the program, not from outside
IN_SCRIPTS = {"{{ script }}", "{{ content }}"}  # the program's own, and JSON that is escaped


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_template_cannot_write_markup_from_outside(path):
    text = path.read_text("utf-8")
    tree = jinja2.Environment(extensions=[]).parse(text)
    assert not {found.name for found in tree.find_all(nodes.Filter)} & UNESCAPED
    assert not list(tree.find_all(nodes.ScopedEvalContextModifier)) and "autoescape" not in text
    inside = "".join(re.findall(r"<style.*?</style>|{% block style %}.*?{% endblock %}", text, re.DOTALL))
    assert set(re.findall(r"{{.*?}}", inside)) <= IN_STYLE
    inside = "".join(re.findall(r"<script.*?</script>", text, re.DOTALL))
    assert set(re.findall(r"{{.*?}}", inside)) <= IN_SCRIPTS
    plain = re.sub(r"{%.*?%}|{#.*?#}", "", text, flags=re.DOTALL)
    assert not re.search(r"""<[a-z][^<>]*=\s*{{""", plain), "an attribute without quotes"
    assert not re.search(r"""\bon[a-z]+\s*=\s*["'][^"']*{{""", plain), "an expression in an event handler"


def test_what_stands_in_a_script_cannot_leave_it():
    script = str(_as_script({"name": EVIL, EVIL: [EVIL]}))
    assert not set("<>&") & set(script) and json.loads(script) == {"name": EVIL, EVIL: [EVIL]}


def claims_page(sections: list[Section], title: str, lead: str, run: str, version: str, **images: str) -> str:
    """Return a page of claims."""
    data = {name: image.encode() for name, image in images.items()}
    return of_sections(sections, data, title=title, lead=lead, run=run, versions={"python": version})


def test_the_page_of_claims():
    claim = Claim(f"{EVIL} claim", 1.0, 0.5, f"{EVIL} unit", f"{EVIL} why")
    section = Section(key="a", title=f"{EVIL} section", text=[f"{EVIL} text"], claims=[claim])
    html = claims_page([section], f"{EVIL} title", f"{EVIL} lead", f"{EVIL} run", f"{EVIL} version")
    words = ("claim", "unit", "why", "section", "text", "lead", "run", "version")
    check_page(html, *(f"{EVIL} {word}" for word in words))


def identification_page(word: str) -> str:
    """Return the page of an identification, with a word in all that others name."""
    row = Identified(f"{word} name", "body_mass", "kg", 0.033, 0.034, (0.033, 0.035), 0.0, f"{word} said")
    found = Identification(
        vehicle=load_vehicle(),
        reference=VehiclePosterior.of_file(None, load_vehicle()),
        parameters=(row,),
        identifiable=(),
        ahead={},
        regimes={},
        kept=(),
        disturbance={},
        fields={},
        flights=(f"{word} flight",),
        notes=(f"{word} note",),
    )
    return identified.page(found, heldout=(f"{word} heldout",), versions={"python": "3"})


def test_the_page_of_identification():
    html = identification_page(EVIL)
    check_page(html, *(f"{EVIL} {word}" for word in ("name", "said", "flight", "note", "heldout")))
