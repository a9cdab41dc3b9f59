"""The documents: code blocks run, commands have their options."""

import re

import numpy as np
import pytest

from inclined_landing.eval.logs import write_log
from inclined_landing.models.parameters import load_vehicle, write_vehicle
from tests import ROOT, documents
from tests.log_files import a_log

# Documents whose Python blocks take minutes.
LONG = {"eval/gap/README.md"}


def _flights(folder):
    """Logs with the names that documents use, of a vehicle that circles."""
    t = np.arange(0, 4, 0.01)
    position = np.stack([np.cos(t), np.sin(t), np.full_like(t, 1.2)], axis=1)
    tilt = -position[:, :2] / 9.81
    command = np.c_[
        np.full_like(t, 36_000.0) + 2_000 * np.sin(3 * t), -tilt[:, 1], tilt[:, 0], np.zeros_like(t)
    ]
    log = a_log(len(t), t=t, position=position, attitude=0.9 * command[:, 1:], command=command)
    for name in ("flight1.csv", "flight2.csv.gz", "flights/fit/fit_01.csv"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_log(folder / name, log)


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """A folder with the files that documents take for granted."""
    _flights(tmp_path)
    write_vehicle(tmp_path / "vehicle.toml", load_vehicle())
    (tmp_path / "other.xml").write_text("<mujoco/>", "utf-8")
    (tmp_path / "models").symlink_to(ROOT / "models")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("inclined_landing.envs.tasks._OWN", {})


@pytest.mark.parametrize("name", sorted(set(documents.documents()) - LONG))
def test_python_blocks_run(name, workplace, capsys):
    def take(language, title, example):
        if language == "python":
            documents.run_python(title, example)

    for example in documents.blocks(name, take).examples():
        example.evaluate()


@pytest.mark.parametrize("name", documents.documents())
def test_commands_exist_with_their_options(name):
    def take(language, title, example):
        if language in documents.SHELLS:
            for words in documents.lines(example.parsed):
                documents.check(words)

    document = documents.blocks(name, take)
    for example in document.examples():
        example.evaluate()
    sentences = "".join(document.text)
    for _, region in reversed(document.regions):
        sentences = sentences[: region.start] + sentences[region.end :]
    for span in documents.SPAN.finditer(sentences):
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


def test_pages_for_users_are_short():
    """Tables of results are in docs/evidence."""
    names = set(documents.documents()) - {"CONTRIBUTING.md", "CHANGELOG.md", "THIRD_PARTY_NOTICES.md"}
    texts = ((ROOT / name).read_text("utf-8") for name in names if "/evidence/" not in name)
    words = re.sub(r"<!--.*?-->", "", " ".join(texts), flags=re.DOTALL).split()
    assert len(words) < 30_000
    assert sum(any(letter.isdigit() for letter in word) for word in words) < 0.05 * len(words)


@pytest.mark.parametrize(
    "line",
    [
        "landing-eval succes landing",
        "landing-eval success landing --planet hybrid",
        "FOO=1 nohup landing-train landing --step 5 &",
        "make dem",
        "pip install 'inclined-landing[everything]'",
        "python -m tests.validation gap-blind --set dev --out DIR",
    ],
)
def test_a_wrong_line_is_found(line):
    with pytest.raises((AssertionError, ValueError)):
        for words in documents.lines(line):
            documents.check(words)
