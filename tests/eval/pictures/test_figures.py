"""Figures show the numbers they are given; picture commands write whole files or one sentence."""

import json

import imageio_ffmpeg
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from inclined_landing.envs.flights import Flight
from inclined_landing.envs.tasks import make_task
from inclined_landing.eval import cli
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.pictures.figures.trajectory import trajectory_figure
from inclined_landing.eval.pictures.learning import learning_curves
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from tests.policy_files import hovering

SLOPE = load_vehicle().platform_inclination
LANDING = make_task("landing")


def landing_flight(**changes):
    """A smooth way from (1.5, 1.8) to the goal in 1.2 s."""
    t = np.linspace(0.0, 1.2, 61)
    share = t / t[-1]
    state = np.zeros((61, 13))
    state[:, 0], state[:, 2] = 1.5 * (1 - share) ** 2, 1.25 + 0.55 * (1 - share)
    state[:, 7] = SLOPE * share + 0.3 * np.sin(3 * share)
    commands = np.zeros((61, 4))
    commands[:, 0], commands[:, 2] = 34000 + 9000 * np.sin(5 * t), 0.5 * np.cos(4 * t)
    fields = {
        "task": LANDING, "t": t, "state": state, "commands": commands, "actions": np.zeros((61, 2)),
        "reward": np.zeros(61), "inclination": SLOPE, "success": True, "touched": False,
    }  # fmt: skip
    return Flight(**fields | changes)


def by_gid(artists, prefix):
    return [a for a in artists if (a.get_gid() or "").startswith(prefix)]


def middle(image):
    left, right, bottom, top = image.get_extent()
    return np.array([0.5 * (left + right), 0.5 * (bottom + top)])


@pytest.fixture(scope="module")
def drawn():
    """The figure of `landing_flight`."""
    return trajectory_figure(landing_flight())


def test_curves_are_the_flight(drawn):
    flight = landing_flight()
    _, pitch, pwm = drawn.axes
    lines = {line.get_label(): line for axes in (pitch, pwm) for line in axes.lines}
    expected = {
        "pitch": np.degrees(flight.state[:, 7]),
        "pitch command": np.degrees(flight.commands[:, 2]),
        "PWM command": flight.commands[:, 0] / 1000,
    }
    for label, values in expected.items():
        np.testing.assert_array_equal(lines[label].get_xdata(), flight.t)
        np.testing.assert_allclose(lines[label].get_ydata(), values, rtol=1e-12)
    # a command is held until the next one
    assert lines["PWM command"].get_drawstyle() == lines["pitch command"].get_drawstyle() == "steps-post"
    np.testing.assert_allclose(lines["inclination"].get_ydata(), np.degrees(SLOPE))


def test_copies_stand_where_the_vehicle_was(drawn):
    flight = landing_flight()
    scene, pitch, _ = drawn.axes
    copies = by_gid(scene.images, "copy")
    samples = [int(image.get_gid().split()[1]) for image in copies]
    assert samples[0] == 0 and samples[-1] == 60 and 3 <= len(samples) <= 11
    for k, image in zip(samples, copies):
        np.testing.assert_allclose(middle(image), flight.state[k, [0, 2]], atol=1e-12)
    (marks,) = by_gid(pitch.collections, "copies")
    np.testing.assert_array_equal([path[0][0] for path in marks.get_segments()], flight.t[samples])
    # a mark has the colour of the way where its copy stands
    (way,) = by_gid(scene.collections, "way")
    for k, colour in zip(samples[:-1], marks.get_colors()):
        assert to_hex(way.get_colors()[k]) == to_hex(colour)
    np.testing.assert_array_equal(way.get_segments()[5], flight.state[5:7, [0, 2]])
    (target,) = by_gid(scene.images, "target")
    np.testing.assert_allclose(middle(target), flight.task.goal[:2], atol=1e-12)


def test_figures_refuse_what_they_cannot_draw(tmp_path):
    flight = landing_flight()
    flight.state[3, 0] = np.nan
    with pytest.raises(UserError, match="finite"):
        trajectory_figure(flight)
    figure = trajectory_figure(landing_flight())
    with pytest.raises(UserError, match=r"\.png or \.pdf"):
        save_figure(figure, tmp_path / "way.jpg")
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="cannot create the folder"):
        save_figure(figure, tmp_path / "file" / "way.png")


# --- learning curves ------------------------------------------------------------------------------


def write_run(folder, task="landing", rate=1.0, rows=40):
    folder.mkdir()
    steps = 8192 * np.arange(1, rows + 1)
    level = np.minimum(1.0, rate * np.arange(rows) / rows)
    learning = {"steps": steps, "episode_reward": -100 + 90 * level, "episode_length": 200 - 100 * level}
    pd.DataFrame(learning | {"level": level}).to_csv(folder / "learning.csv", index=False)
    column = "strict_success" if task == "landing" else "mean_error"
    values = level if task == "landing" else 2.0 * 0.02**level
    pd.DataFrame({"steps": steps, column: values})[9::10].to_csv(folder / "evaluations.csv", index=False)
    (folder / "run.json").write_text(json.dumps({"config": {"task": task}}))
    return folder


def test_one_run_is_one_line(tmp_path):
    run = write_run(tmp_path / "a")
    axes = learning_curves([run]).axes
    assert [a.get_ylabel().split(" [")[0] for a in axes] == [
        "goal box reached, strict",
        "curriculum level",
        "episode length",
        "episode reward",
    ]
    (line,) = by_gid(axes[0].lines, "run")
    table = pd.read_csv(run / "evaluations.csv")
    np.testing.assert_allclose(line.get_xdata(), table["steps"] / 1e6)
    np.testing.assert_allclose(line.get_ydata(), 100 * table["strict_success"])
    assert not by_gid(axes[0].collections, "band")
    (shaded,) = by_gid(axes[3].patches, "curriculum")
    table = pd.read_csv(run / "learning.csv")
    last = table["steps"][table["level"] == table["level"].iloc[-1]].iloc[0]
    np.testing.assert_allclose(shaded.get_width(), last / 1e6)


def test_nominal_and_varied_vehicles_are_two_curves(tmp_path):
    run = write_run(tmp_path / "a")
    table = pd.read_csv(run / "evaluations.csv")
    kinds = {"strict_success_nominal": 1.0, "strict_success_varied": table["strict_success"] / 2}
    table.assign(**kinds).to_csv(run / "evaluations.csv", index=False)
    axes = learning_curves([run]).axes[0]
    nominal, varied = by_gid(axes.lines, "run")
    assert (nominal.get_ydata() == 100.0).all()
    np.testing.assert_allclose(varied.get_ydata(), 50 * table["strict_success"])
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["nominal vehicle", "varied vehicles"] and nominal.is_dashed() != varied.is_dashed()


def test_seeds_have_median_and_range(tmp_path):
    runs = [write_run(tmp_path / str(k), rate=rate) for k, rate in enumerate((0.5, 1.0, 3.0))]
    level = learning_curves(runs).axes[1]
    assert len(by_gid(level.lines, "run")) == 3
    (median,) = by_gid(level.lines, "median")
    np.testing.assert_allclose(median.get_ydata(), pd.read_csv(runs[1] / "learning.csv")["level"])
    assert len(by_gid(level.collections, "band")) == 1


def test_a_folder_that_is_not_a_run_is_refused(tmp_path):
    run = write_run(tmp_path / "a")
    for content in ("[]", '{"config": 3}'):
        (run / "run.json").write_text(content)
        with pytest.raises(UserError, match=r"run\.json does not name"):
            learning_curves([run])


@pytest.mark.parametrize("end", ["", ","])
def test_a_table_that_ends_within_a_row_is_drawn_up_to_it(tmp_path, end):
    run = write_run(tmp_path / "a")
    text = (run / "learning.csv").read_text()
    (run / "learning.csv").write_text(text[: text.rindex("\n", 0, -1) + 3] + end)
    figure = learning_curves([run])
    (line,) = by_gid(figure.axes[1].lines, "run")
    assert len(line.get_xdata()) == 39


# --- commands -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hover_policy(tmp_path_factory):
    """Keeps its height, level, until the time limit: all weights zero."""
    return str(hovering(tmp_path_factory.mktemp("policy") / "hover.zip"))


def test_figure_command_writes_the_paper_s_two_cases(hover_policy, tmp_path, capsys):
    assert cli.main(["figure", hover_policy, "--out", str(tmp_path / "new"), "--plant", "analytic"]) == 0
    names = {f"trajectory_{case}{suffix}" for case in (1, 2) for suffix in (".png", ".pdf")}
    assert {p.name for p in (tmp_path / "new").iterdir()} == names
    out, err = capsys.readouterr()
    assert "from x 1.5, z 1.8 m: goal box not reached" in out and "from x 0, z 2 m" in out and not err
    assert "0 of 2 flights succeeded; " in out.splitlines()[-1] and str(tmp_path / "new") in out


def test_video_command_flies_all_starts(hover_policy, tmp_path):
    out = tmp_path / "two.mp4"
    size = ["--width", "96", "--height", "64", "--backend", "ray"]
    starts = ["--start", "-1.5,1.6", "--start", "1,2"]
    arguments = [*size, *starts, "--plant", "analytic", "--slow", "0.1", "--gif"]
    assert cli.main(["video", hover_policy, "--out", str(out), *arguments]) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["two.gif", "two.mp4"]
    for name, rate in (("two.mp4", 50.0), ("two.gif", 25.0)):
        reader = imageio_ffmpeg.read_frames(str(tmp_path / name))
        meta = next(reader)
        assert tuple(meta["size"]) == (96, 64) and meta["fps"] == pytest.approx(rate)
        # two flights of 6 s at ten times the speed, 1 s of rest after each
        assert len(list(reader)) / rate == pytest.approx(2 * (6.0 / 10 + 1.0), abs=0.1)
