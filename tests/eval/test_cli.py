"""`landing-eval`: help, JSON, and one sentence with exit code 2 for whatever is wrong."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from inclined_landing.envs.shared import command_line, runs
from inclined_landing.eval import cli
from inclined_landing.models import plugins
from tests.policy_files import hovering
from tests.refused import refused


@pytest.fixture(scope="module")
def landing_policy(tmp_path_factory):
    """Hovers: all weights zero."""
    return hovering(tmp_path_factory.mktemp("policy") / "hover.zip")


def test_options_are_known_without_their_machinery():
    """Nothing but NumPy and tyro is imported before a command does its work; in a process of its own."""
    code = """
import sys
from inclined_landing.eval import cli
from inclined_landing.train import cli as training

def check(what, *light):
    heavy = {"torch", "mujoco", "numba", "scipy", "pandas", "matplotlib", "PIL", "pyarrow", "jinja2", "rich"}
    assert not (found := {*heavy, *light} & set(sys.modules)), (what, found)

cli.main(["--help"])
check("the list of commands", "tyro", "numpy")
for name in cli.COMMANDS:
    cli.find(name)
    check(name)
    assert cli.main([name, "--sed", "3"]) == 2
    check(name + " --sed")
for words in ["--help-all"], ["--sed", "3"], ["sweep", "landing", "--sed", "3"]:
    training.main(words)
    check(words)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in (*cli.GROUPS, *cli.COMMANDS))


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_a_command_and_its_module_are_called_alike(name):
    command = cli.find(name)
    module = command.__module__.removesuffix(".command")
    assert command.__name__ == "command" and module.endswith("." + name.replace("-", "_"))
    assert command.__doc__.splitlines()[0] == cli.summary(name)


@pytest.mark.parametrize(("words", "sentence"), [
    ([], "no command; see landing-eval --help"),
    (["succes", "x"], "unknown command 'succes'; did you mean success? See landing-eval --help"),
    (["success"], "name at least one policy"),
    (["success", "x", "--seed", "one"], "Error parsing --seed: "),
    (["success", "x", "--inclination=steep"], "Error parsing --inclination: "),
    (["success", "x", "--thrust-scale", "1", "x"], "Error parsing --thrust-scale: "),
    (["robustness", "--draws", "nan"], "Error parsing --draws: "),
    (["success", "x", "--inclination", "nan"], "--inclination must be a number, not nan"),
    (["success", "x", "--thrust-scale", "1", "inf"], "--thrust-scale"),
    (["success", "x", "--out", ""], "--out is empty; is a shell variable unset?"),
    (["success", "x", "--out="], "--out is empty; is a shell variable unset?"),
    (["success", ""], "an argument is empty; is a shell variable unset?"),
    (["success", "x", "--seed"], "Missing value for argument '--seed'"),
    (["success", "x", "--sed", "3"], "Unrecognized options: --sed, 3; Perhaps you meant: --seed INT"),
    (["doctor", "--\nsed", "\udcff" * 200], "Unrecognized options: --"),
    (["logs"], "Error parsing source: name at least one log"),
    (["landings"], "STUDY.toml and --out DIR are missing; see landing-eval landings --help"),
    (["touchdown"], "POLICY is missing; see landing-eval touchdown --help"),
    (["success", "x", "--thrust-scale", "1", "4"], "--thrust-scale must be a number above 0 and of at"),
])  # fmt: skip
def test_words_that_do_not_fit_are_one_sentence(words, sentence, tmp_path):
    said = refused(cli.main, words, f"landing-eval: {sentence}", tmp_path)
    assert len(said) < 450
    ends = ("--help", "one log", "one policy", "unset?", "not nan", "not inf", "not 0.0", "not 4.0")
    assert said.endswith(tuple(f"{end}\n" for end in ends))


@pytest.mark.parametrize(
    ("words", "unbuffered"), [(["--version"], ""), (["--version"], "1"), (["success", "--help"], "")]
)
def test_output_that_cannot_be_written_is_one_sentence(words, unbuffered):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "inclined_landing.eval", *words],
            stdout=full,
            stderr=subprocess.PIPE,
            env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
        )
    assert done.returncode == 2
    assert done.stderr == b"landing-eval: the output cannot be written: no space left on device\n"


ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU)


@pytest.fixture
def heard():
    """Signals as a shell sets them, whichever the tests themselves were started to ignore."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in ENDING}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", ENDING, ids=lambda number: number.name)
def test_a_signal_ends_a_command_and_leaves_nothing(number, heard, tmp_path, capsys):
    """As Ctrl-C does; a closed terminal, which sends several, interrupts no clearing up."""

    def work():
        with runs.staged_run(tmp_path / "out") as folder:
            (folder / "half").touch()
            try:
                os.kill(os.getpid(), number)
            finally:
                os.kill(os.getpid(), signal.SIGHUP)

    before = [signal.getsignal(each) for each in ENDING]
    assert command_line.exit_code("landing-eval", work) == 128 + number
    assert capsys.readouterr().err == "landing-eval: interrupted\n" and not list(tmp_path.iterdir())
    assert [signal.getsignal(each) for each in ENDING] == before


def test_a_signal_that_was_ignored_stays_so(monkeypatch):
    """As `nohup` asks for."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert command_line.exit_code("landing-eval", lambda: os.kill(os.getpid(), signal.SIGHUP)) == 0
    finally:
        signal.signal(signal.SIGHUP, before)


def test_success_prints_json_alone(landing_policy, capsys, tmp_path):
    out = tmp_path / "run"
    arguments = ["--plant", "analytic", "--json", "--seed", "3", "--out", str(out)]
    scales = ["--thrust-scale", "1", "0.9", "--inclination", "-20"]
    assert cli.main(["success", str(landing_policy), *arguments, *scales]) == 0
    report = json.loads(capsys.readouterr().out)
    flights = {
        (row["starts"], row["thrust_scale"]): row["flights"] for row in report["rows"] if row["starts"]
    }
    assert {scale for _, scale in flights} == {1.0, 0.9}
    (inclination,) = [fact["value"] for fact in report["facts"] if fact["name"] == "inclination"]
    assert inclination == pytest.approx(np.radians(-20))
    assert json.loads((out / "success.json").read_text("utf-8")) == report
    figures = {"success_landing.png", "success_landing.pdf"}
    assert {p.name for p in out.iterdir()} == {"flights.csv", "success.json", "index.html"} | figures
    assert len((out / "flights.csv").read_text().splitlines()) == 1 + sum(flights.values())


def test_plugins_that_are_not_built_are_one_sentence(capsys):
    def broken():
        raise ImportError("the native plugins are not built")

    assert command_line.exit_code("landing-eval", broken) == 2
    assert capsys.readouterr().err == "landing-eval: the native plugins are not built\n"


# ---- doctor


def test_doctor_names_the_remedy(monkeypatch, capsys):
    def missing():
        raise ImportError("the native plugins of inclined_landing are not built")

    monkeypatch.setattr(plugins, "load", missing)
    assert cli.main(["doctor"]) == 2
    text = " ".join(capsys.readouterr().out.split())
    assert "are not built" in text and "native plugins: run `make` in the repository" in text
