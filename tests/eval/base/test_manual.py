"""What commands say about themselves: --help, --version, and the scripts that complete command lines."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from inclined_landing.eval import cli, demo
from inclined_landing.eval.base import completion
from inclined_landing.eval.base.command_line import bound
from inclined_landing.eval.base.manual import Manual, Option, manual
from inclined_landing.train.cli import main as train
from inclined_landing.train.config import TrainConfig

DEFAULT = re.compile(r"default:", re.IGNORECASE)
NOTHING = re.compile(r"\{None\}|\(default: (None|False|'')?\)|\(repeatable\)|^\[?(STR|PATH)\b")


@pytest.fixture(scope="module")
def manuals() -> dict[str, Manual]:
    pages = {name: manual(bound(cli.find(name)), f"landing-eval {name}") for name in cli.COMMANDS}
    return pages | {"landing-train": manual(TrainConfig, "landing-train")}


def test_every_option_of_every_command_is_explained_once(manuals):
    for name, page in manuals.items():
        rows = (*page.arguments, *page.options)
        assert len({row.words for row in rows}) == len(rows), name
        for row in rows:
            where = f"{name}: {row.words}: {row.text}"
            assert re.search(r"[a-z]{2}", DEFAULT.sub("", row.text)) and not row.text.startswith("("), where
            assert len(DEFAULT.findall(row.text)) <= 1, where
            assert not NOTHING.search(row.words) and not NOTHING.search(row.text), where
            assert row.text.count("(") == row.text.count(")"), where
            assert row.names or row in page.arguments, where
        assert {"-h"} <= {option for row in page.options for option in row.names}


def test_the_first_line_is_that_of_the_table(manuals):
    for name, (_, line) in cli.COMMANDS.items():
        assert manuals[name].text[0] == line
        assert manuals[name].usage.startswith(f"usage: landing-eval {name} ")


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_page_fits_its_terminal_and_says_all(manuals, width):
    for name, page in manuals.items():
        text = page.page(width)
        long = [line for line in text.splitlines() if len(line) > min(width, 100)]
        assert all(len(line.split()) <= 2 or "{" in line for line in long), (name, long)  # one word alone
        assert not [line for line in text.splitlines() if line != line.rstrip()]
        flat = " ".join(text.split())
        assert all(" ".join(row.text.split()) in flat for row in page.options), name


def test_help_is_printed_for_the_terminal_there_is(monkeypatch, capsys):
    for width in (80, 120):
        monkeypatch.setenv("COLUMNS", str(width))
        for main, words in ((cli.main, ["success", "--help"]), (train, ["-h"])):
            with pytest.raises(SystemExit) as end:
                main(words)
            printed = capsys.readouterr()
            assert end.value.code == 0 and printed.err == ""
            lengths = [len(line) for line in printed.out.splitlines()]
            assert min(width, 100) - 15 < max(lengths) <= min(width, 100)


def test_versions_of_both_programs(capsys):
    assert cli.main(["--version"]) == 0 and train(["--version"]) == 0
    lines = capsys.readouterr().out.splitlines()
    form = r"(landing-\w+) [0-9.]+ \(MuJoCo 4\.0\.0, PyTorch \S+, Python 3\.\d+\.\d+\S*\)"
    assert [re.fullmatch(form, line)[1] for line in lines] == ["landing-eval", "landing-train"]


# ---- completion


@pytest.fixture(scope="module")
def scripts(manuals, tmp_path_factory) -> dict[str, Path]:
    """The scripts of both programs in one file, by shell."""
    folder, rooms = tmp_path_factory.mktemp("completion"), dict(manuals)
    alone = {"": rooms.pop("landing-train")}
    lines = {name: line for name, (_, line) in cli.COMMANDS.items()}
    for shell in completion.SHELLS:
        text = completion.script(shell, "landing-eval", rooms, lines)
        (folder / shell).write_text(text + completion.script(shell, "landing-train", alone, {}))
    return {shell: folder / shell for shell in completion.SHELLS}


LINES = [
    ("landing-eval suc", {"success"}),
    ("landing-eval success --pl", {"--plant"}),
    ("landing-eval success --plant ", {"mujoco", "hybrid", "analytic"}),
    ("landing-eval success landing-r", {"landing-robust"}),
    ("landing-train --upd", {"--update"}),
    ("landing-train --update s", {"stock"}),
]


@pytest.mark.parametrize(("line", "expected"), LINES)
def test_bash_completes(scripts, line, expected):
    words = line.split(" ")
    function = "_" + words[0].replace("-", "_")
    quoted = shlex.join(words)
    code = (
        f"source {scripts['bash']}; compopt() {{ :; }}; COMP_WORDS=({quoted});"
        f' COMP_CWORD={len(words) - 1}; {function}; printf "%s\\n" "${{COMPREPLY[@]}}"'
    )
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, cwd="/", check=True)
    assert done.stderr == "" and set(done.stdout.split()) == expected


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed")
def test_fish_completes(scripts):
    for line, expected in LINES:
        code = f"source {scripts['fish']}; complete -C '{line}'"
        done = subprocess.run(["fish", "-N", "-c", code], capture_output=True, text=True, cwd="/", check=True)
        assert {row.split("\t")[0] for row in done.stdout.splitlines()} == expected, line


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed")
def test_zsh_reads_its_script(scripts):
    subprocess.run(["zsh", "-n", scripts["zsh"]], check=True)
    code = f"autoload -Uz compinit; compinit -D -u; source {scripts['zsh']}; print $_comps[landing-eval]"
    done = subprocess.run(["zsh", "-f", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "_landing_eval" and done.stderr == ""


def test_texts_cannot_leave_their_quotes():
    """Help with quotes, brackets and dollars, as a task or an effect of one's own may have it."""
    evil = Option("--evil WORD", 'it\'s $(touch /tmp/x) `this` [and: that] \\ "so"')
    page = Manual("usage: x", ("Line.",), (), (evil,))
    for shell in completion.SHELLS:
        text = completion.script(shell, "x", {"go": page}, {"go": 'It\'s $(here): [and] "so"'})
        if shutil.which(shell):
            subprocess.run([shell, "-n"], input=text, text=True, check=True)


def test_what_is_asked_for_is_printed_and_another_shell_refused(capsys):
    for words in (["--print-completion", "bash"], ["--print-completion=bash"]):
        assert train(words) == 0
        assert "complete -F _landing_train landing-train" in capsys.readouterr().out
    for words in (["--print-completion", "tcsh"], ["--print-completion"]):
        assert train(words) == 2
        printed = capsys.readouterr()
        assert printed.out == "" and "takes one of bash, zsh, fish, not" in printed.err


# ---- demo


def test_demo_counts_films_and_pictures(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(demo, "LOOK", {"width": 64, "height": 48})
    out = tmp_path / "demo"
    assert cli.main(["demo", "--out", str(out), "--starts", "4", "--seed", "5"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"random, seed 5 +4 +100\.0 \[51\.0, 100\.0\] +4 ", printed)
    names = sorted(path.name for path in out.iterdir())
    assert names == ["landing.gif", "landing.html", "landing.mp4", "landing.png"] and all(
        name in printed for name in names
    )
    assert cli.main(["demo", "--out", str(out)]) == 2
    assert "exists and is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["demo"]
