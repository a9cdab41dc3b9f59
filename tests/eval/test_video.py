"""Videos and stroboscopic pictures of flights."""

import imageio_ffmpeg
import numpy as np
import pytest

from inclined_landing.envs.flights import Flight
from inclined_landing.envs.tasks import make_task
from inclined_landing.eval.pictures.frames import caption_of, render_flight, strobe, write_video
from inclined_landing.models.errors import UserError


def flight(seconds=0.4, period=0.02):
    t = np.arange(0.0, seconds + 1e-9, period)
    state = np.zeros((len(t), 13))
    state[:, 0], state[:, 2], state[:, 7] = 1.0 - t, 1.8, 0.3
    commands = np.tile([42000.0, 0, 0.3, 0], (len(t), 1))
    none = np.zeros((len(t), 2))
    return Flight(make_task("landing"), t, state, none, commands, none[:, 0], -0.45, False, False)


def test_frames_follow_the_clock():
    """0.4 s at 50 frames a second: 21 samples, both ends included; 11 at half the rate."""
    options = dict(width=160, height=120, backend="ray")
    frames = list(render_flight(flight(), **options))
    assert len(frames) == 21
    assert all(frame.shape == (120, 160, 3) and frame.dtype == np.uint8 for frame in frames)
    assert len(list(render_flight(flight(), fps=25, **options))) == 11
    assert (frames[0] != frames[-1]).any()


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_video_reads_back(tmp_path, suffix):
    frames = list(render_flight(flight(0.2), width=160, height=120, backend="ray"))
    path = write_video(tmp_path / "new" / f"flight{suffix}", frames, fps=25)
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
        write_video(tmp_path / "flight.mp4", broken())
    assert not list(tmp_path.iterdir())


def test_strobe_draws_copies_along_the_way():
    picture = strobe(flight(), width=320, height=180, backend="ray")
    single = strobe(flight(), width=320, height=180, backend="ray", copies=1)
    assert picture.shape == (180, 320, 3)
    assert (picture != single).any(axis=2).sum() > 50


def test_caption_names_time_place_attitude_and_command():
    assert caption_of(flight(), 5) == ("t 0.10 s   x +0.90  z 1.80 m   pitch  +17.2 deg   PWM  42000")


def test_wrong_videos_are_sentences(tmp_path):
    with pytest.raises(UserError, match=r"\.mp4 or \.gif file, not 'flight\.avi'"):
        write_video(tmp_path / "flight.avi", [])
    with pytest.raises(UserError, match=r"no frames for flight\.mp4"):
        write_video(tmp_path / "flight.mp4", [])
