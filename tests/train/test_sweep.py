"""Sweeps: every run and command done once, whatever happens on the way; Ctrl-C ends the processes."""

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

from inclined_landing.envs import tasks
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.recipe import read_recipe
from inclined_landing.models.errors import UserError
from inclined_landing.train import cli
from inclined_landing.train.sweep import children, command, jobs, record
from inclined_landing.train.sweep.check import check
from inclined_landing.train.sweep.children import Children, Stopped
from tests.test_own_task import CODE as OWN_TASK
from tests.training import assert_same_policy

# In place of landing-train and landing-eval: notes its words, writes what the recipe looks for.
PRETENDED = """
import json, os, sys
from pathlib import Path
words = sys.argv[1:]
given = dict(zip(words, words[1:]))
with open("calls.txt", "a") as calls:
    print(*words, os.environ["OMP_NUM_THREADS"], file=calls)
print("said", *words)
out = Path(given["--out"])
if "--no-report" in words:  # a training
    if os.path.exists("fails") and given["--seed"] == Path("fails").read_text():
        sys.exit("error: it diverged")
    assert out.exists() == ("--resume" in words), out
    out.mkdir(exist_ok=True)
    (out / "run.json").write_text("{}")
    if os.path.exists("interrupted"):
        os.unlink("interrupted")
        sys.exit(130)
    (out / "metrics.json").write_text(json.dumps({"steps": int(given["--seed"]), "ended": "well"}))
    sys.exit(3 if "0.9" in words else 0)
assert not out.exists(), out
out.mkdir(parents=True)
(out / "success.json").write_text(json.dumps({"share": {"count": 9, "of": 10}}))
if os.path.exists("half"):
    os.unlink("half")
    sys.exit(1)
"""
RECIPE = {
    "title": "Pretended",
    "question": "Is all done once?",
    "train": ["landing", "--steps", "100"],
    "seeds": [5, 6],
    "variants": {"a": [], "b": ["--gamma", "0.9"]},
    "evaluate": [["success", "{run}/final.zip", "--seed", "{seed}", "--out", "{run}/s"]],
    "together": [["success", "{run}/final.zip", "--out", "{sweep}/all"]],
    "numbers": {
        "steps": {"file": "metrics.json", "path": "steps", "unit": "steps", "better": "lower", "bar": 5},
        "share": {"file": "s/success.json", "path": "share", "unit": "%", "factor": 100, "better": "higher"},
    },
}


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a recipe, in which the two programs are pretended."""
    (tmp_path / "pretended.py").write_text(PRETENDED)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    monkeypatch.setattr(children, "PROGRAMS", dict.fromkeys(children.PROGRAMS, "pretended"))
    monkeypatch.chdir(tmp_path)
    write(RECIPE)
    return tmp_path


def write(data, name="pretended.toml"):
    Path(name).write_text("# kept\n" + tomlkit.dumps(data), "utf-8")


def calls() -> list[str]:
    """What was run since the last time."""
    file = Path("calls.txt")
    lines = file.read_text().splitlines() if file.exists() else []
    file.unlink(missing_ok=True)
    return lines


def sweep(*words) -> int:
    return cli.main(["sweep", "pretended.toml", *words])


def test_every_run_is_trained_and_judged_once_then_all_together(place, capsys):
    cores = len(os.sched_getaffinity(0))
    assert sweep("--jobs", "1") == 0
    done = calls()
    assert len(done) == 4 * 2 + 1
    assert (
        done[0]
        == f"landing --steps 100 --seed 5 --out runs/pretended/a-5 --no-report --threads {cores} {cores}"
    )
    assert done[1] == f"success runs/pretended/a-5/final.zip --seed 5 --out runs/pretended/a-5/s {cores}"
    assert done[-1].startswith("success runs/pretended/a-5/final.zip --out runs/pretended/all ")
    result = json.loads(Path("runs/pretended/result.json").read_text())
    assert [m["values"] for m in result["measured"] if m["number"] == "steps"] == [[5, 6]] * 2
    assert [m["mean"] for m in result["measured"] if m["number"] == "share"] == [90, 90]
    assert len(result["runs"]) == 4 and all(0 < run["cpu_seconds"] < 60 for run in result["runs"])
    assert result["versions"]["mujoco"] == "4.0.0" and result["machine"]
    printed = capsys.readouterr().out
    assert "5.5 (5 to 6) steps" in printed and "missed" in printed
    assert sweep() == 0 and not calls()  # everything is there


def test_side_by_side_the_cores_are_shared_out(place):
    cores = len(os.sched_getaffinity(0))
    assert sweep("--jobs", "4") == 0
    assert {line.split()[-1] for line in calls() if line.startswith("landing")} == {str(max(1, cores // 4))}


def test_what_was_interrupted_is_resumed_and_what_was_half_done_begun_again(place, capsys):
    Path("interrupted").touch()
    assert sweep("--jobs", "1") == 1
    assert "a-5: landing-train landing ended with 130: said landing" in capsys.readouterr().err
    assert not Path("runs/pretended/result.json").exists() and len(calls()) == 1 + 3 * 2
    assert sweep("--jobs", "1") == 0
    resumed, *rest = calls()
    assert "--resume" in resumed and "a-5" in resumed and len(rest) == 2
    Path("half").touch()
    assert sweep("--out", "other", "--jobs", "1") == 1 and calls()
    assert sweep("--out", "other", "--jobs", "1") == 0 and len(calls()) == 2  # that one, and all together


def test_an_interrupted_run_that_keeps_no_checkpoint_is_begun_again(place):
    Path("interrupted").touch()
    assert sweep("--jobs", "1") == 1 and calls()
    Path("runs/pretended/a-5/run.json").write_text('{"config": {"algorithm": "sac"}}')
    assert sweep("--jobs", "1") == 0  # the pretended training asserts that its folder is gone
    assert "--resume" not in calls()[0]


def test_a_failed_run_leaves_the_others_and_no_result(place, capsys):
    Path("fails").write_text("6")
    assert sweep("--record") == 1
    said = capsys.readouterr().err
    assert said.count("error: it diverged") == 2 and said.count(": failed after ") == 2
    assert all("it diverged" in line for line in said.splitlines()[-2:])
    assert "[result]" not in Path("pretended.toml").read_text()
    assert Path("runs/pretended/a-5/s/success.json").exists()


def test_new_seeds_and_commands_are_added_and_another_training_is_refused(place, capsys):
    assert sweep() == 0 and calls()
    write(RECIPE | {"seeds": [5, 6, 7]})
    assert sweep() == 0 and len(calls()) == 2 * 2  # what is done together names no other run
    more = [*RECIPE["evaluate"], ["success", "landing", "--out", "{run}/t"]]
    write(RECIPE | {"evaluate": more})
    assert sweep() == 0 and len(calls()) == 4
    write(RECIPE | {"evaluate": [["success", "landing", "--out", "{run}/s"]]})
    assert sweep() == 0 and len(calls()) == 4  # in the place of the old one
    write(RECIPE | {"train": ["landing", "--steps", "200"]})
    assert sweep() == 2 and not calls()
    assert "was begun as landing-train landing --steps 100" in capsys.readouterr().err


def test_a_moved_sweep_goes_on(place):
    assert sweep() == 0 and calls()
    os.rename("runs/pretended", "elsewhere")
    assert sweep("--out", "elsewhere") == 0 and not calls()


def test_without_training_the_variants_are_the_evaluations(place):
    data = {key: value for key, value in RECIPE.items() if key != "train"}
    data["numbers"] = {"share": RECIPE["numbers"]["share"]}
    data["variants"] = {"mujoco": ["--plant", "{variant}"], "hybrid": ["--plant", "{variant}"]}
    data["evaluate"] = [["success", "landing", "--seed", "{seed}", "--out", "{run}/s"]]
    write(data)
    assert sweep("--jobs", "1") == 0
    assert calls()[1].startswith("success landing --seed 5 --out runs/pretended/hybrid-5/s --plant hybrid ")


def test_the_result_is_recorded_and_comments_stay(place):
    for _ in range(2):
        assert sweep("--record") == 0
        text = Path("pretended.toml").read_text()
        assert text.startswith("# kept\n") and text.count("[result]") == 1
        recipe = read_recipe("pretended.toml")
        assert recipe.result["command"] == "landing-train sweep pretended.toml"
        assert len(recipe.result["measured"]) == 4
    assert sweep() == 0 and len(calls()) == 9  # a recipe with a result is the same recipe


@pytest.mark.parametrize(
    ("change", "words", "sentence"),
    [
        ({}, ["--on", "moon"], "--on must be local or ray"),
        ({}, ["--address", "here:1"], "--address belongs to --on ray"),
        ({}, ["--jobs", "-1"], "--jobs must be a whole number from 0"),
        ({}, ["--out", "pretended.py"], "is not a folder"),
        ({}, ["--out", "."], "exists and is not empty"),
        ({"train": ["landing", "--step", "3"]}, [], "--step"),
        ({"train": ["landing", "--gamma", "2"]}, [], "--gamma must be a number above 0 and below 1"),
        ({"train": ["--help"]}, [], "--help does no work"),
        ({"train": ["--tyro-write-completion", "bash", "x"]}, [], "--tyro-write-completion is no option"),
        ({"evaluate": [["moving", "--tyro_write-completion", "bash", "x"]]}, [], "is no option"),
        ({"variants": {"a": ["--curriculum", "steep"]}}, [], "unknown curriculum"),
        ({"evaluate": [["sucess", "x"]]}, [], "'sucess' is no command that a recipe may run"),
        ({"evaluate": [["success"]]}, [], "POLICY"),
        ({"seeds": "many"}, [], "seeds must be a list"),
    ],
)
def test_wrong_input_is_one_sentence_and_nothing_begins(change, words, sentence, place, capsys):
    write(RECIPE | change)
    before = sorted(place.rglob("*"))
    assert sweep(*words) == 2
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1 and said.startswith("landing-train: ")
    assert sorted(place.rglob("*")) == before


# A recipe is data. Imported, this would leave a file.
FOREIGN = "from pathlib import Path\nPath('imported').touch()\ndef fly(t, states, decks): pass\n"


@pytest.mark.parametrize(
    "change",
    [
        {"train": ["foreign.py:Hop"]},
        {"train": ["foreign:Hop", "--steps", "100"]},
        {"variants": {"a": [], "b": ["--from", "foreign.py:Hop"]}},
        {"evaluate": [["success", "x.zip", "--task=foreign.py:Hop", "--out", "{run}/s"]]},
        {"evaluate": [["moving", "planner", "{here}/foreign.py:fly", "--out", "{run}/s"]]},
        {
            "together": [
                ["video", "x.zip", "--task", "{here}/../{sweep}/foreign:Hop", "--out", "{sweep}/v.gif"]
            ]
        },
    ],
)
def test_python_that_nobody_named_is_not_imported(change, place, capsys):
    Path("foreign.py").write_text(FOREIGN)
    write(RECIPE | change)
    before = sorted(place.rglob("*"))
    assert sweep() == 2
    said = capsys.readouterr().err
    assert "would run Python, which a recipe alone may not" in said and "name it: --allow " in said
    assert said.count("\n") == 1 and sorted(place.rglob("*")) == before and "foreign" not in sys.modules


def test_python_that_is_named_is_imported(place, capsys, monkeypatch):
    monkeypatch.setattr(tasks, "_OWN", {})
    Path("foreign.py").write_text(FOREIGN)
    Path("loop.py").symlink_to("loop.py")
    write(RECIPE | {"evaluate": [["moving", "{here}/foreign.py:fly", "--out", "{run}/s"]]})
    for words, sentence in (
        (["--allow", "foreign.py:land"], "--allow ./foreign.py:fly"),
        (["--allow", "loop.py:fly"], "--allow ./foreign.py:fly"),
        (["--allow", "foreign"], "--allow takes module:NAME or FILE.py:NAME, not foreign"),
        (
            ["--allow", "foreign.py:fly", "--allow", "os:system"],
            "--allow os:system: the recipe names no such",
        ),
    ):
        assert sweep(*words) == 2 and sentence in capsys.readouterr().err
    assert sweep("--allow", str(place / "foreign.py:fly"), "--record") == 0
    assert any("moving ./foreign.py:fly" in line for line in calls())
    assert "sweep pretended.toml --allow /" in read_recipe("pretended.toml").result["command"]
    Path("hop.py").write_text(OWN_TASK)
    write(RECIPE | {"train": ["hop.py:Hop"]})
    assert sweep("--allow", "hop.py:Hop", "--out", "own") == 0


@pytest.fixture
def begun(place):
    """The folder of a sweep that was begun."""
    folder = place / "runs" / "pretended"
    (folder / "steps").mkdir(parents=True)
    (folder / "pretended.toml").write_text("")
    return folder


@pytest.mark.parametrize(
    "out",
    ["/tmp/x", "x", "{sweep}/../../x", "{run}/../x", "{run}", "{sweep}/x", "{run}/link/x", "{here}/x",
     "{run}/metrics.json", "{run}/tensorboard/x"],
)  # fmt: skip
def test_a_run_writes_into_its_folder_alone(out, place, begun, capsys):
    for run in ("a-5", "b-5"):
        (begun / run).mkdir()
        (begun / run / "link").symlink_to(place)
    write(RECIPE | {"evaluate": [["success", "landing", f"--out={out}"], *RECIPE["evaluate"]]})
    before = sorted(place.rglob("*"))
    assert sweep() == 2 and not calls()
    assert "--out must be a new name in {run}, beside what is there" in capsys.readouterr().err
    assert sorted(place.rglob("*")) == before


@pytest.mark.parametrize(
    "out", ["/tmp/x", "{sweep}", "{sweep}/..", "{run}", "{run}/x", "{sweep}/steps/x", "{sweep}/result.json"]
)
def test_what_is_done_together_writes_beside_the_runs(out, place, capsys):
    write(RECIPE | {"together": [["success", "landing", "--out", out]]})
    assert sweep() == 2 and "--out must be a new name in {sweep}, beside its runs" in capsys.readouterr().err


def test_a_run_folder_that_leads_elsewhere_is_refused(place, begun, capsys):
    (begun / "a-6").symlink_to(place)
    assert sweep() == 2 and "out of the sweep" in capsys.readouterr().err
    (begun / "a-6").unlink()
    (begun / "a-6").symlink_to("a-6")
    assert sweep() == 2 and "a-6" in capsys.readouterr().err


def test_a_number_or_picture_that_nothing_writes_is_refused(place, capsys):
    share = RECIPE["numbers"]["share"]
    for change, sentence in (
        (
            {"numbers": {"n": share | {"file": "t/success.json"}}},
            "number n: a run will have no t/success.json;",
        ),
        ({"figure": "{sweep}/all/x.png", "video": "{run}/x.gif"}, "video: no command of the recipe writes"),
    ):
        write(RECIPE | change)
        assert sweep() == 2 and sentence in capsys.readouterr().err and not calls()
    data = {key: value for key, value in RECIPE.items() if key not in ("train", "variants")}
    write(data)  # metrics.json is of a training
    assert sweep() == 2 and "it has what is in s" in capsys.readouterr().err


def test_a_number_that_is_not_found_costs_one_run(place, capsys):
    wrong = {"share": RECIPE["numbers"]["share"] | {"path": "shares"}}
    write(RECIPE | {"numbers": wrong})
    assert sweep("--jobs", "1") == 2
    said = capsys.readouterr().err
    assert "success.json has no shares; the sweep stops: correct the recipe" in said.splitlines()[-1]
    assert len(calls()) <= 2 * 2  # the next run may have begun when the first had ended
    assert not Path("runs/pretended/result.json").exists()
    write(RECIPE)
    assert sweep() == 0
    assert not [line for line in calls() if "pretended/a-5" in line and "--seed 5" in line]


def test_the_programs_import_nothing_from_where_they_are_run(tmp_path, monkeypatch):
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "quiet.py").write_text("import json, numpy\n")
    for name in ("json.py", "numpy.py", "runpy.py", "inclined_landing.py"):
        (tmp_path / name).write_text("raise SystemExit('foreign')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "modules"))
    monkeypatch.setitem(children.PROGRAMS, "landing-eval", "quiet")
    assert Children().run(["landing-eval"], subprocess.DEVNULL, 1).code == 0


def test_a_recipe_that_is_not_there_and_ray_that_is_not_installed(place, capsys, monkeypatch):
    assert cli.main(["sweep", "none.toml"]) == 2
    said = capsys.readouterr().err
    assert "recipe none.toml does not exist (shipped ones: " in said and " landing," in said
    monkeypatch.setitem(sys.modules, "ray", None)
    assert sweep("--on", "ray") == 2
    assert capsys.readouterr().err == (
        "landing-train: --on ray needs Ray, which is not installed; pip install 'inclined-landing[ray]'\n"
    )


@pytest.mark.parametrize("text", ["[", "{}", '[{"words": []}]', '[{"words": ["a"], "code": "x"}]', "3"])
def test_a_damaged_record_is_refused(text, place):
    job = jobs.of_runs(read_recipe("pretended.toml"), Path("runs"), place)["a", 5]
    job.record.parent.mkdir(parents=True)
    job.record.write_text(text)
    with pytest.raises(UserError, match=r"record \S+a-5\.json is "):
        jobs.read(job)


def test_processes_end_when_the_sweep_does(tmp_path, monkeypatch):
    (tmp_path / "sleeper.py").write_text("import time; time.sleep(60)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setitem(children.PROGRAMS, "landing-eval", "sleeper")
    group, ended = Children(), []
    threads = [
        threading.Thread(target=lambda: ended.append(group.run(["landing-eval"], subprocess.DEVNULL, 1)))
        for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    while len(group._running) < 2:
        time.sleep(0.01)
    group.stop()
    for thread in threads:
        thread.join(10)
    assert [one.code for one in ended] == [-signal.SIGTERM] * 2
    with pytest.raises(Stopped):
        group.run(["landing-eval"], subprocess.DEVNULL, 1)


def test_processes_end_when_the_sweep_is_killed(tmp_path):
    (tmp_path / "sleeper.py").write_text("import os, time; print(os.getpid(), flush=True); time.sleep(60)")
    code = (
        "from inclined_landing.train.sweep import children\n"
        "children.PROGRAMS['landing-eval'] = 'sleeper'\n"
        "children.Children().run(['landing-eval'], 1, 1)"
    )
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    first = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, env=environment)
    begun = psutil.Process(int(first.stdout.readline()))
    first.kill()
    first.communicate()
    assert psutil.wait_procs([begun], timeout=10)[0]


def test_no_two_processes_do_the_same_job(place):
    job = jobs.of_runs(read_recipe("pretended.toml"), Path("runs"), place)["a", 5]
    job.log.parent.mkdir(parents=True)
    with runs.held(job.run, job.log) as log:
        other = os.dup(log)  # as the program that was begun has it
    with pytest.raises(UserError, match=r"another process works in the run folder \S+a-5; wait"):
        jobs.work(job, Children(), 1, patience=0.1)
    assert not calls() and not job.record.exists()
    timer = threading.Timer(0.3, os.close, [other])
    timer.start()
    steps = jobs.work(job, Children(), 1, patience=60)
    timer.join(0)
    assert [step.code for step in steps] == [0, 0]


def test_what_a_process_takes_is_measured_with_its_own_children(tmp_path, monkeypatch):
    work = "import time\nwhile time.process_time() < 0.3: pass"
    (tmp_path / "busy.py").write_text(
        f"import subprocess, sys\nsubprocess.run([sys.executable, '-c', '''{work}'''])"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setitem(children.PROGRAMS, "landing-eval", "busy")
    ended = Children().run(["landing-eval"], subprocess.DEVNULL, 1)
    assert ended.code == 0 and 0.3 <= ended.cpu_seconds < 5 and ended.wall_seconds > 0.3


def test_only_what_the_sweep_wrote_makes_room(tmp_path):
    recipe = tmp_path / "r.toml"
    recipe.write_text(tomlkit.dumps(RECIPE))
    runs = jobs.of_runs(read_recipe(recipe), tmp_path / "sweep", tmp_path)
    job = runs["a", 5]
    inside = {"{run}/s": True, "{run}": False, "{sweep}": False, "{sweep}/steps/x": False, "/tmp": False}
    for out, expected in inside.items():
        (words,) = job.filled([out])
        assert (job.inside(Path(words)) is not None) is expected, out
    assert not job.inside(job.run / ".." / ".." / "x")


def test_a_recipe_that_cannot_be_written_is_said_before(tmp_path):
    with pytest.raises(UserError, match="folder"):
        record.check(tmp_path)


def test_shipped_recipes_are_right():
    for name, path in command.shipped().items():
        recipe = read_recipe(path)
        runs = jobs.of_runs(recipe, Path("runs", name), path.parent)
        check(recipe, runs, jobs.of_all(recipe, Path("runs", name), path.parent))
        if recipe.result is not None:
            command.measured.read(recipe, recipe.result)


@pytest.mark.slow
def test_a_real_sweep_interrupted_and_resumed_ends_as_one_left_alone(tmp_path):
    small = ["--environments", "8", "--rollout", "64", "--batch-size", "256", "--checkpoint-every", "2"]
    data = {
        "title": "Tiny",
        "question": "Does it run?",
        "train": ["landing", "--steps", "16384", *small],
        "seeds": [1, 2],
        "evaluate": [["success", "{run}/final.zip", "--plant", "analytic", "--out", "{run}/s"]],
        "numbers": {
            "strict": {
                **{"file": "s/success.json", "path": "conditions.0.grid.strict"},
                **{"unit": "%", "factor": 100, "better": "higher"},
            }
        },
    }
    write(data, tmp_path / "tiny.toml")

    def begin(out):
        words = ["-m", "inclined_landing.train", "sweep", "tiny.toml", "--out", out, "--jobs", "2"]
        return subprocess.Popen([sys.executable, *words], cwd=tmp_path)

    alone = begin("alone")
    assert alone.wait() == 0
    first = begin("again")
    until = time.monotonic() + 120
    while not (tmp_path / "again" / "seed-1" / "checkpoint.pt").exists():
        assert time.monotonic() < until
        time.sleep(0.05)
    own = psutil.Process(first.pid).children(recursive=True)
    first.send_signal(signal.SIGINT)
    assert first.wait(60) == 130
    assert not [p for p in own if p.is_running()]
    assert begin("again").wait() == 0
    results = [json.loads((tmp_path / out / "result.json").read_text()) for out in ("alone", "again")]
    assert results[0]["measured"] == results[1]["measured"]
    for run in ("seed-1", "seed-2"):
        assert_same_policy(*(tmp_path / out / run / "final.zip" for out in ("alone", "again")))
