"""The documents: code blocks run, commands have their options, links lead somewhere, the site builds."""

import gzip
import logging
import re
import shutil

import pytest

from inclined_landing.models.parameters import load_vehicle, write_vehicle
from tests import ROOT, documents
from tests.campaign.inputs import flight

# Documents whose Python blocks take minutes.
LONG = {"eval/gap/README.md"}


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """A folder with the files that documents take for granted."""
    (tmp_path / "flights" / "fit").mkdir(parents=True)
    for name in ("flight1.csv", "flights/fit/fit_01.csv"):
        (tmp_path / name).write_text(flight())
    (tmp_path / "flight2.csv.gz").write_bytes(gzip.compress(flight().encode()))
    write_vehicle(tmp_path / "vehicle.toml", load_vehicle())
    (tmp_path / "other.xml").write_text("<mujoco/>", "utf-8")
    (tmp_path / "models").symlink_to(ROOT / "models")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("inclined_landing.envs.tasks._OWN", {})


@pytest.mark.parametrize("name", sorted(set(documents.documents()) - LONG))
def test_python_blocks_run(name, workplace, capsys):
    namespace = {}
    for number, (_, title, text) in enumerate(documents.blocks(name, "python")):
        documents.run_python(title, text, namespace, f"{name}, Python block {number}")


@pytest.mark.parametrize("name", documents.documents())
def test_commands_exist_with_their_options(name):
    for _, _, text in documents.blocks(name, *documents.SHELLS):
        for words in documents.lines(text):
            documents.check(words)
    for span in documents.SPAN.finditer(documents.prose(name)):
        documents.check_span(span[1])


@pytest.mark.parametrize("name", documents.documents())
def test_links_lead_somewhere(name):
    """On a code host, where they are relative paths; the site translates these (docs/site/hooks.py)."""
    for target, anchor in documents.links(name):
        assert target.exists(), f"{name}: {target}"
        page = target / "README.md" if target.is_dir() else target
        if anchor:
            file = page.resolve().relative_to(ROOT).as_posix()
            assert anchor in documents.anchors(file), f"{name}: {file}#{anchor}"


def test_the_navigation_has_every_page_once():
    text = (ROOT / "mkdocs.yml").read_text("utf-8")
    included = dict(re.findall(r"^    (\S+\.md): (\S+)$", text, re.MULTILINE))
    entries = re.findall(r"(?:: |- )(\S+\.md)$", text.partition("\nnav:\n")[2], re.MULTILINE)
    written = [file.relative_to(ROOT / "docs").as_posix() for file in (ROOT / "docs").glob("**/*.md")]
    assert sorted(entries) == sorted([*written, *included.values(), *documents.generated.pages()])


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path, monkeypatch):
    """Strictly: pages and anchors that links lead to, pages that the navigation lacks, names to document."""
    pytest.importorskip("mkdocs", reason="mkdocs is not installed (extra `docs`)")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    monkeypatch.setenv("NO_MKDOCS_2_WARNING", "1")
    before = logging.getLogger("mkdocs").level
    build(load_config(str(ROOT / "mkdocs.yml"), strict=True, site_dir=str(tmp_path)))
    logging.getLogger("mkdocs").setLevel(before)
    commands = (tmp_path / "reference/commands.html").read_text("utf-8")
    assert 'id="success"' in commands and "--thrust-scale" in commands
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "landing.gif" in page and (tmp_path / "landing.gif").is_file()
    assert "https://arxiv.org/abs/2103.09043\n" in (tmp_path / "external_links.txt").read_text("utf-8")
    shutil.rmtree(tmp_path)  # some megabytes
