"""Gymnasium's own wrappers around the environments."""

import gymnasium as gym
import imageio_ffmpeg
import pytest
from gymnasium import wrappers

import inclined_landing.envs  # noqa: F401 (registers the environments)

ID = "InclinedLanding-v0"
PICTURE = {"render_mode": "rgb_array", "width": 96, "height": 64, "render_backend": "ray"}


@pytest.mark.slow
def test_record_video_writes_a_film_that_plays(tmp_path):
    pytest.importorskip("moviepy", reason="moviepy is not installed")
    env = wrappers.RecordVideo(gym.make(ID, plant="analytic", **PICTURE), str(tmp_path), disable_logger=True)
    env.reset(seed=0)
    for _ in range(4):
        env.step(env.action_space.sample())
    env.close()
    (film,) = tmp_path.glob("*.mp4")
    reader = imageio_ffmpeg.read_frames(str(film))
    meta = next(reader)
    assert tuple(meta["size"]) == (96, 64) and meta["fps"] == pytest.approx(50)
    assert len(list(reader)) == 5
