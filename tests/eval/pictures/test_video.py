"""Videos and stroboscopic pictures of flights."""

import copy
import dataclasses

import imageio_ffmpeg
import numpy as np
import pytest

from inclined_landing.envs.flights import Flight
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.tasks import make_task
from inclined_landing.eval.base.options import Look
from inclined_landing.eval.pictures.flights import fly_from
from inclined_landing.eval.pictures.frames import render_flight, renderer_for, write_videos
from inclined_landing.eval.pictures.starts import usual_starts
from inclined_landing.eval.pictures.to_rest import to_rest
from inclined_landing.eval.study.rest import VariantChoice, cut_motors
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.plants.recorder import still


def flight(seconds=0.4, period=0.02):
    t = np.arange(0.0, seconds + 1e-9, period)
    state = np.zeros((len(t), 13))
    state[:, 0], state[:, 2], state[:, 7] = 1.0 - t, 1.8, 0.3
    commands = np.tile([42000.0, 0, 0.3, 0], (len(t), 1))
    none = np.zeros((len(t), 2))
    rest = {"reward": none[:, 0], "inclination": -0.45, "success": False, "touched": False}
    return Flight(task=make_task("landing"), t=t, state=state, actions=none, commands=commands, **rest)


def frames_of(flown, **options):
    with renderer_for([flown], Look("arena", 160, 120, "ray")) as renderer:
        return list(render_flight(flown, renderer, **options))


def test_frames_follow_the_clock():
    """0.4 s at 50 frames a second: 21 samples, both ends included; 11 at half the rate."""
    frames = frames_of(flight())
    assert len(frames) == 21
    assert all(frame.shape == (120, 160, 3) and frame.dtype == np.uint8 for frame in frames)
    assert len(frames_of(flight(), fps=25)) == 11
    assert (frames[0] != frames[-1]).any()


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_video_reads_back(tmp_path, suffix):
    frames = frames_of(flight(0.2))
    path = tmp_path / "new" / f"flight{suffix}"
    write_videos({path: 1}, frames, fps=25)
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    assert tuple(meta["size"]) == (160, 120) and meta["fps"] == pytest.approx(25)
    seen = [np.frombuffer(f, np.uint8).reshape(120, 160, 3).astype(int) for f in reader]
    assert len(seen) == len(frames)
    # lossy coding: grey levels off by a few on average
    assert np.abs(seen[0] - frames[0]).mean() < 6


def test_failure_leaves_nothing_behind(tmp_path):
    def broken():
        yield np.zeros((120, 160, 3), np.uint8)
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="no more"):
        write_videos({tmp_path / "flight.mp4": 1}, broken())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("echo 'a: x' >&2; echo 'b: Error: No space left on device' >&2; exit 1", "no space left on device"),
        ("kill -9 $$", "ffmpeg was killed; is the disk full"),
        ("kill -XFSZ $$", "ffmpeg was killed; is the disk full"),
    ],
)
def test_ffmpeg_that_fails_is_one_sentence(code, said, tmp_path, monkeypatch):
    (tmp_path / "ffmpeg").write_text(f"#!/bin/bash\n{code}\n")
    (tmp_path / "ffmpeg").chmod(0o755)
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: str(tmp_path / "ffmpeg"))
    for frames in (1, 30):  # what a pipe holds, and more
        with pytest.raises(UserError, match=rf"cannot write .*new/a\.mp4: {said}"):
            write_videos({tmp_path / "new" / "a.mp4": 1}, [np.zeros((120, 160, 3), np.uint8)] * frames)
    assert [path.name for path in tmp_path.iterdir()] == ["ffmpeg"]


@pytest.fixture(scope="module")
def landed():
    """The shipped policy's first film start, and the flight with what followed the motor cut."""
    policy = load_policy("landing-nominal")
    flight = fly_from(policy, usual_starts(policy.task)[:1], "mujoco")[0]
    return flight, to_rest(flight)


def test_a_landing_goes_on_to_rest_with_its_motors_cut(landed):
    flight, whole = landed
    cut = len(flight.t) - 1
    assert whole.cut == cut and whole.duration == flight.duration < whole.t[-1]
    np.testing.assert_array_equal(whole.state[: cut + 1], flight.state)
    assert not whole.commands[cut:].any() and whole.commands[:cut, 0].all()
    np.testing.assert_allclose(np.diff(whole.t), flight.t[1], rtol=1e-9)
    assert {len(rows) for rows in (whole.t, whole.state, whole.commands, whole.actions, whole.reward)} == {
        len(whole.t)
    }
    # At rest where the success table's own judgement of the same cut says so, tilted as the slope is.
    task = flight.task
    judged = cut_motors(flight.state[-1:], flight.inclination, VariantChoice(task.vehicle))
    assert whole.at_rest == judged.at_rest_on_feet[0] and whole.ending == "at rest on its feet"
    assert still(whole.state, whole.platform)[whole.settled :].all()
    assert not still(whole.state, whole.platform)[whole.settled - 1]
    # Feet sink in by less than 5 mm, over a base of some 7 cm: below 0.1 rad.
    assert whole.state[-1, 7] == pytest.approx(flight.inclination, abs=0.05)
    normal_height = whole.state[-1, :3] - [0, 0, task.vehicle.platform_surface_height]
    height = normal_height @ [np.sin(flight.inclination), 0, np.cos(flight.inclination)]
    assert 0.0 < height < 0.04


def test_what_slides_off_is_said(landed):
    """On a slope without friction nothing holds: the vehicle ends on the floor, or is still on its way."""
    flight, _ = landed
    slippery = copy.copy(flight.task)
    slippery.vehicle = dataclasses.replace(flight.task.vehicle, contact_friction=0.05)
    whole = to_rest(dataclasses.replace(flight, task=slippery))
    assert not whole.at_rest and whole.ending in ("fell to the floor", "still sliding", "still moving")
    assert whole.t[-1] <= flight.duration + 2.0 + 1e-9
