"""Sweeps: every command done once, whatever happens on the way; numbers by known truths."""

import copy
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from inclined_landing.envs.shared import runs
from inclined_landing.models.base.errors import UserError
from inclined_landing.train import cli
from inclined_landing.train.sweep import command, jobs
from inclined_landing.train.sweep.recipe import Number, read_recipe, shipped
from inclined_landing.train.sweep.result import sum_up, take
from tests.refused import refused

# In place of landing-train and landing-eval: notes its words, writes what the recipe looks for.
PRETENDED = """
import json, os, sys
from pathlib import Path
words = sys.argv[1:]
given = dict(zip(words, words[1:])) | dict(word.split("=", 1) for word in words if "=" in word)
with open("calls.txt", "a") as calls:
    print(*words, os.environ["OMP_NUM_THREADS"], file=calls)
print("said", *words)
out = Path(given["--out"])
if "--no-report" in words:  # a training
    if os.path.exists("fails") and given["--seed"] == Path("fails").read_text():
        sys.exit("error: it diverged")
    assert ("--resume" in words) == (out / "run.json").exists()
    out.mkdir(exist_ok=True)
    (out / "run.json").write_text("{}")
    if os.path.exists("interrupted"):
        os.unlink("interrupted")
        sys.exit(130)
    (out / "metrics.json").write_text(json.dumps({"steps": int(given["--seed"])}))
    sys.exit(3 if "0.9" in words else 0)
assert not out.exists(), out
out.mkdir(parents=True)
row = {"of": 1, "statistic": "share", "count": 9, "flights": 10}
(out / "success.json").write_text(json.dumps({"rows": [row]}))
if os.path.exists("half"):
    os.unlink("half")
    sys.exit(1)
"""
RECIPE = {
    "title": "Pretended",
    "question": "Is all done once?",
    "answer": "After {a.steps}, {b.share}.",
    "seeds": [5, 6],
    "commands": [
        "landing-train landing --steps 100 {options} --seed {seed} --out={out} --no-report",
        "landing-eval success {out}/final.zip --seed {seed} --out {out}/s",
    ],
    "variants": {"a": "", "b": "--gamma 0.9"},
    "numbers": {
        "steps": {"title": "steps", "file": "metrics.json", "path": "steps", "unit": "steps", "at_least": 6},
        "share": {"title": "s", "file": "s/success.json", "row": {"of": 1}, "unit": "%", "factor": 100},
    },
}


@pytest.fixture
def begun(tmp_path, monkeypatch):
    """A folder with a recipe, in which the two programs are pretended."""
    (tmp_path / "pretended.py").write_text(PRETENDED)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(jobs, "PROGRAMS", dict.fromkeys(jobs.PROGRAMS, "pretended"))
    monkeypatch.chdir(tmp_path)
    write(RECIPE)
    return tmp_path


@pytest.fixture
def place(begun, monkeypatch):
    """The same, where a command begins at once: in an interpreter that imports nothing of ours."""

    def run(words, directory, log, threads):
        environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
        command = [sys.executable, "-S", "-E", "-u", str(begun / "pretended.py"), *words[1:]]
        return subprocess.run(command, stdout=log, stderr=log, env=environment).returncode, 0.1

    monkeypatch.setattr(jobs, "_run", run)
    return begun


def write(data, name="pretended.toml"):
    Path(name).write_text(tomlkit.dumps(data), "utf-8")


def calls() -> list[str]:
    """What was run since the last time."""
    file = Path("calls.txt")
    lines = file.read_text().splitlines() if file.exists() else []
    file.unlink(missing_ok=True)
    return lines


def sweep(*words) -> int:
    return cli.main(["sweep", "pretended.toml", *words])


def test_every_command_is_done_once_for_every_run(place, capsys):
    cores = len(os.sched_getaffinity(0))
    assert sweep("--jobs", "1") == 0
    done = calls()
    assert len(done) == 4 * 2
    trained = "landing --steps 100 --seed 5 --out=runs/pretended/a-5 --no-report"
    assert done[0] == f"{trained} --threads {cores} {cores}"
    assert done[1] == f"success runs/pretended/a-5/final.zip --seed 5 --out runs/pretended/a-5/s {cores}"
    result = json.loads(Path("runs/pretended/result.json").read_text())
    assert [m["values"] for m in result["measured"] if m["number"] == "steps"] == [[5, 6]] * 2
    assert [m["mean"] for m in result["measured"] if m["number"] == "share"] == [90, 90]
    assert len(result["cpu_seconds"]) == 4 and all(0 < seconds < 60 for seconds in result["cpu_seconds"])
    printed = capsys.readouterr().out
    assert "6: missed" in printed and printed.endswith("After 5.5 (5 to 6) steps, 90 %.\n")
    assert sweep() == 0 and not calls()  # everything is there
    os.rename("runs/pretended", "elsewhere")
    assert sweep("--out", "elsewhere") == 0 and not calls()


def test_what_was_interrupted_is_resumed_and_what_was_half_done_begun_again(place, capsys):
    Path("interrupted").touch()
    assert sweep("--jobs", "1") == 1
    assert "a-5: landing-train landing --steps" in (said := capsys.readouterr().err)
    assert " ended with 130: said landing" in said
    assert not Path("runs/pretended/result.json").exists() and len(calls()) == 1 + 3 * 2
    assert sweep("--jobs", "1") == 0
    resumed, *rest = calls()
    assert "--resume" in resumed and "a-5" in resumed and len(rest) == 1
    Path("half").touch()
    assert sweep("--out", "other", "--jobs", "1") == 1 and calls()
    assert sweep("--out", "other", "--jobs", "1") == 0 and len(calls()) == 1


def test_a_failed_run_leaves_the_others_and_no_result(place, capsys):
    Path("fails").write_text("6")
    assert sweep() == 1
    said = capsys.readouterr().err
    assert said.count(": failed (") == 2
    assert all("error: it diverged" in line for line in said.splitlines()[-2:])
    assert Path("runs/pretended/a-5/s/success.json").exists()
    assert not Path("runs/pretended/result.json").exists()


def test_added_seeds_and_commands_are_run_and_changed_ones_refused(place, capsys):
    assert sweep() == 0 and calls()
    write(RECIPE | {"seeds": [5, 6, 7]})
    assert sweep() == 0 and len(calls()) == 2 * 2
    training, judged = RECIPE["commands"]
    write(RECIPE | {"commands": [training, judged, "landing-eval success landing --out {out}/t"]})
    assert sweep() == 0 and len(calls()) == 4
    write(RECIPE | {"commands": [training.replace("100", "200"), judged]})
    assert sweep() == 2 and not calls()
    assert "was begun with other command lines; choose another --out" in capsys.readouterr().err


def test_a_number_that_is_not_there_is_said_and_nothing_lost(place, capsys):
    wrong = copy.deepcopy(RECIPE)
    wrong["numbers"]["share"]["row"] = {"of": 2}
    write(wrong)
    assert sweep() == 2
    assert "number share: runs/pretended/a-5/s/success.json has no row with" in capsys.readouterr().err
    assert len(calls()) == 8
    write(RECIPE)
    assert sweep() == 0 and not calls()


@pytest.mark.parametrize(("change", "words", "sentence"), [
    ({}, ["--address", "here:1"], "--address needs --on ray"),
    ({}, ["--out", "pretended.py"], "is not a folder"),
    ({}, ["--out", "."], "exists and is not empty"),
    ({"commands": ["landing-train landing --step 3"]}, [], "--step"),
    ({"commands": ["landing-train landing --gamma 2"]}, [], "--gamma must be a number above"),
    ({"commands": ["landing-train --help"]}, [], "unknown command --help"),
    ({"variants": {"a": "", "b": "--gamma"}}, [], "--gamma"),
    ({"commands": ["landing-eval sucess x"]}, [], "unknown command sucess"),
    ({"commands": ["landing-eval touchdown"]}, [], "POLICY"),
    ({"commands": ["rm -r {out}"]}, [], "a command line begins with landing-train or landing-eval"),
    ({"commands": ["landing-train 'landing"]}, [], "quotation"),
    ({"commands": ["landing-train landing --seed {sed}"]}, [], "unknown placeholder {sed} in landing-train"),
    ({"answer": "{steps}"}, [], "unknown placeholder {steps} in {steps}; choose from a.steps"),
    ({"seeds": [1, 1]}, [], "a seed is listed twice"),
])  # fmt: skip
def test_wrong_input_is_one_sentence_and_nothing_begins(change, words, sentence, place):
    write(RECIPE | change)
    said = refused(cli.main, ["sweep", "pretended.toml", *words], sentence, place)
    assert said.startswith("landing-train: ")


def test_a_recipe_that_is_not_there_and_ray_that_is_not_installed(place, capsys, monkeypatch):
    assert cli.main(["sweep", "none.toml"]) == 2
    assert "recipe none.toml does not exist (shipped ones: " in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "ray", None)
    assert sweep("--on", "ray") == 2
    assert "--on ray needs Ray, which is not installed; pip install" in capsys.readouterr().err


@pytest.mark.parametrize("name", shipped())
def test_shipped_recipes_would_begin(name, tmp_path):
    command.Sweep(read_recipe(shipped()[name]), tmp_path, "").check()


# ---- processes


@pytest.mark.parametrize("text", ["[", "{}", '[{"line": "a"}]', '[{"line": "a", "cpu_seconds": "x"}]', "3"])
def test_a_damaged_record_is_refused(text, place):
    job = jobs.jobs_of(read_recipe(Path("pretended.toml")), Path("runs"))["a", 5]
    job.record.parent.mkdir(parents=True)
    job.record.write_text(text)
    with pytest.raises(UserError, match=r"record \S+a-5\.json"):
        job.done()


def test_no_two_processes_do_the_same_job(place):
    job = jobs.jobs_of(read_recipe(Path("pretended.toml")), Path("runs"))["a", 5]
    job.log.parent.mkdir(parents=True)
    with runs.locked(job.folder, job.log) as log:
        other = os.dup(log)  # as the program that was begun has it
    with pytest.raises(UserError, match=r"another process is using the run folder \S+a-5; wait"):
        jobs.work(1, 0.1, job)
    assert not calls() and not job.record.exists()
    timer = threading.Timer(0.3, os.close, [other])
    timer.start()
    assert jobs.work(1, 60.0, job) == (pytest.approx(0.2), "") and len(job.done()) == 2
    timer.join(0)


def test_only_what_the_sweep_wrote_makes_room(tmp_path):
    job = jobs.Job("a-5", (), str(tmp_path / "sweep"), str(tmp_path))
    for place, gone in (("a-5/s", True), ("a-5", False), ("", False), ("steps", False), ("../x", False)):
        out = Path(job.sweep, place)
        out.mkdir(parents=True, exist_ok=True)
        jobs._prepared(job, f"landing-eval success --out {out}", 1)
        assert out.exists() is not gone, place


@pytest.mark.parametrize(
    "number",
    [*(pytest.param(n, marks=pytest.mark.slow) for n in (signal.SIGINT, signal.SIGTERM)), signal.SIGKILL],
)
def test_commands_end_with_the_sweep(number, begun):
    Path("pretended.py").write_text("import os, time; print(os.getpid(), flush=True); time.sleep(60)")
    code = (
        "import sys; from inclined_landing.train import cli; from inclined_landing.train.sweep import jobs\n"
        "jobs.PROGRAMS = dict.fromkeys(jobs.PROGRAMS, 'pretended')\n"
        "sys.exit(cli.main(['sweep', 'pretended.toml', '--jobs', '2']))"
    )
    # A test run that was started in the background ignores SIGINT, and so would what it starts.
    process = subprocess.Popen(
        [sys.executable, "-c", code], preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    )
    logs = [Path("runs/pretended/steps", name) for name in ("a-5.log", "b-5.log")]
    until = time.monotonic() + 60
    while not all(log.exists() and log.read_text() for log in logs):
        assert time.monotonic() < until and process.poll() is None
        time.sleep(0.05)
    begun = [psutil.Process(int(log.read_text())) for log in logs]
    process.send_signal(number)
    assert process.wait(20) == (128 + number if number != signal.SIGKILL else -number)
    assert psutil.wait_procs(begun, timeout=10)[1] == []
    assert not Path("runs/pretended/steps/a-6.log").exists()


# ---- numbers over seeds


def number(**changed) -> Number:
    return Number(**{"title": "n", "file": "m.json", "path": "n", "unit": "%"} | changed)


def summed(*values, **changed):
    return sum_up("", "n", number(**changed), list(values))


def test_flights_of_all_seeds_are_one_share_with_wilsons_interval():
    found = summed((9, 10), (30, 30), (5, 10), factor=100.0)
    interval = binomtest(44, 50).proportion_ci(method="wilson")
    assert found.values == (90.0, 100.0, 50.0) and found.median == 90.0 and found.mean == pytest.approx(88.0)
    assert found.interval == pytest.approx((100 * interval.low, 100 * interval.high))
    assert found.range_words(number()) == "90 (50 to 100) %"


def test_true_and_false_are_a_share_of_the_seeds():
    found = summed(True, False, True)
    interval = binomtest(2, 3).proportion_ci(method="wilson")
    assert found.mean == pytest.approx(2 / 3) and found.range_words(number()) == "0.667 %"
    assert found.interval == pytest.approx((interval.low, interval.high))


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=8))
@settings(max_examples=30, deadline=None)
def test_the_bootstrap_lies_within_the_values_and_around_their_mean(values):
    found = summed(*values)
    low, high = found.interval
    room = 1e-9 * (1 + max(map(abs, values)))  # rounding of the mean of eight numbers
    assert min(values) - room <= low <= found.mean + room and found.mean - room <= high <= max(values) + room


def test_a_seed_that_never_got_there_counts_as_larger_than_all():
    found = summed(None, 5, 7, unit="steps")
    assert found.median == 7 and found.mean is None and found.interval is None
    assert found.range_words(number(unit="steps")) == "7 (5 to 7) steps, never in 1 of 3"
    assert summed(None, None).range_words(number()) == "–, never in 2 of 2"
    with pytest.raises(UserError, match="number in one run and share in another"):
        summed(1, True)


def test_numbers_are_taken_from_where_they_stand(tmp_path):
    text = '{"n": 3, "t": true, "no": null, "l": [1, 2.5], "w": "x"}'
    (tmp_path / "m.json").write_text(text)

    def of(path):
        return take("n", number(path=path), tmp_path)

    assert of("n") == 3 and of("t") is True
    assert of("l.1") == 2.5 and of("no") is of("no.steps") is None
    for path in ("x", "l.2", "l.y", "n.x", "w"):
        with pytest.raises(UserError, match="number n"):
            of(path)
    (tmp_path / "m.json").unlink()
    with pytest.raises(UserError, match=r"m\.json does not exist"):
        of("n")
