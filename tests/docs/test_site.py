"""The documentation site builds, and every link in it leads somewhere."""

import logging
import shutil

import pytest

from tests import ROOT

pytestmark = pytest.mark.slow


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
