"""Pictures: geometry to the pixel, layers, shadows, and what happens without OpenGL."""

import subprocess
import sys

import numpy as np
import pytest

from inclined_landing.envs.rendering import Ghost, look_at, make_renderer
from inclined_landing.envs.rendering import gl as gl_backend
from inclined_landing.envs.rendering.overlay import caption_height
from inclined_landing.envs.rendering.pose import pose_from_state, qpos_of_state, resting_platform
from inclined_landing.envs.rendering.ray import RayRenderer
from inclined_landing.envs.tasks import TASKS, make_task
from inclined_landing.envs.tasks import frozen as starts
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.geometry import shapes_of
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.scene import build_spec

W, H = 320, 240


def hovering(x=0.9, z=1.7, pitch=0.2):
    state = np.zeros(13)
    state[[0, 2, 7]] = x, z, pitch
    return state


def over(state, inclination=None):
    """The pose of a state over the platform of the vehicle file, or over one of another inclination."""
    return pose_from_state(state, resting_platform(load_vehicle(), inclination))


def changed(a, b):
    """Pixels that differ, (h, w) bool."""
    return (a.astype(int) != b.astype(int)).any(axis=2)


@pytest.fixture(scope="module")
def hero():
    return make_renderer(W, H, "hero", "ray")


@pytest.fixture(scope="module")
def side():
    return make_renderer(W, H, "side", "ray", scale=1.0)


def test_kept_background_equals_a_fresh_picture_bit_for_bit(hero):
    states = np.stack([hovering(x=1.2 - 0.02 * k) for k in range(20)])
    trail = hero.centres(states)
    goal = Ghost(qpos_of_state(hovering(0.0, 1.2, -0.4)))
    for k in (3, 10, 19):
        kept = hero.render(over(states[k]), trail=trail[: k + 1], ghosts=[goal], caption="x")
        fresh = RayRenderer(width=W, height=H, camera="hero").render(
            over(states[k]), trail=trail[: k + 1], ghosts=[goal], caption="x"
        )
        np.testing.assert_array_equal(kept, fresh)


def test_several_renderers_draw_what_one_does(hero):
    """The second one shares the background, but neither the vehicle nor the platform."""
    one, other = hero.several(2)
    tilted = one.render(over(hovering(), -0.8))
    for _ in range(2):
        np.testing.assert_array_equal(
            other.render(over(hovering())), hero.several(1)[0].render(over(hovering()))
        )
        np.testing.assert_array_equal(one.render(over(hovering(), -0.8)), tilted)


def test_side_camera_shows_metres_exactly():
    """The markers' centres appear where the orthographic projection puts them.

    A marker covers about 0.6 pixels here, so the vehicle is drawn 8x; the centroid of a disc of
    radius 2.4 pixels, sampled at pixel centres, is within 0.25 pixels of its centre.
    """
    with make_renderer(W, H, "side", "ray", scale=8.0) as renderer:
        state = hovering(0.3, 1.5, 0.0)
        view = renderer.view(over(state))
        scene = renderer._scene
        assert view.orthographic
        pixel_per_metre = H / view.extent
        column, row = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
        rays = view.rays(column.ravel(), row.ravel())
        geom, _, _ = scene.cast(view.eye, rays, 2)
        for k in range(3):
            marker = scene.model.geom(f"marker_{k}").id
            seen = (geom == marker).reshape(H, W)
            x, _, z = scene.data.geom_xpos[marker]
            expected = (0.5 * W + x * pixel_per_metre, 0.5 * H - (z - view.origin[2]) * pixel_per_metre)
            assert seen.sum() >= 8
            assert abs(column[seen].mean() - expected[0]) < 0.25
            assert abs(row[seen].mean() - expected[1]) < 0.25


def test_rays_meet_the_points_they_are_cast_at(hero, side):
    for renderer in (hero, side):
        view = renderer.view(over(hovering()))
        points = np.array([[0.3, 0.0, 1.5], [-1.0, 0.0, 0.7], [0.5, 0.0, 2.0]])
        pixel, depth = view.project(points)
        rays = view.rays(pixel[:, 0], pixel[:, 1])
        np.testing.assert_allclose(view.eye + depth[:, None] * rays, points, atol=1e-6)


def test_shadow_falls_where_the_light_says():
    """Above the floor, beside the platform: the shadow's centre is the vehicle's along the light."""
    view = look_at([1.6, 0.0, 6.0], [1.6, 0.001, 0.0], W, H, extent=3.0)
    with make_renderer(W, H, view, "ray", scale=1.0) as renderer:
        state = hovering(1.6, 1.0, 0.0)
        empty = renderer.render(over(state), show_vehicle=False)
        ghost = Ghost(qpos_of_state(state), alpha=0.0, shadow=True)
        assert not changed(empty, renderer.render(over(state), show_vehicle=False, ghosts=[ghost])).any()
        mask = changed(empty, renderer.render(over(state)))
        sun = renderer._scene.sun[2]
        foot = state[:3] - state[2] / sun[2] * sun
        place = view.project(foot[None])[0][0]
        body = view.project(state[None, :3])[0][0]
        rows, columns = np.nonzero(mask)
        apart = np.hypot(columns + 0.5 - body[0], rows + 0.5 - body[1]) > 12
        assert apart.sum() > 20
        # the vehicle is 11 pixels wide; its shadow's centroid lies within one pixel
        middle = np.array([columns[apart].mean() + 0.5, rows[apart].mean() + 0.5])
        assert np.hypot(*(middle - place)) < 1.0


@pytest.mark.parametrize("width, height", [(640, 480), (960, 540), (480, 640), (1000, 200)])
def test_the_default_camera_sees_every_start(width, height):
    """All of the vehicle as it is drawn, above the caption: the frozen grid, random starts of all tasks."""
    with make_renderer(width, height, backend="ray") as renderer:
        reach = renderer.scale * shapes_of(build_spec().compile()).reach[0]
        view = renderer.view(over(hovering()))
        corners = reach * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        positions = [starts.grid()[:, [0, 0, 1]] * [1, 0, 1]]
        rng = np.random.default_rng(width)
        positions += [make_task(name).sample(rng, 500).state[:, :3] for name in TASKS]
        pixels, depth = view.project(np.concatenate([p + corner for p in positions for corner in corners]))
    assert (depth > 0).all()
    assert (pixels >= 0).all() and (pixels <= [width, height - caption_height(height)]).all()


def test_trail_is_hidden_behind_the_platform():
    points = np.array([[-0.6, 0.6, 0.6], [0.6, 0.6, 0.6]])  # behind the base, seen from y < 0
    with make_renderer(W, H, "side", "ray") as renderer:
        empty = renderer.render(over(hovering()), show_vehicle=False)
        mask = changed(empty, renderer.render(over(hovering()), show_vehicle=False, trail=points))
        view = renderer.view(over(hovering()))
        v = load_vehicle()
        half = v.slab_half_length * np.cos(v.platform_inclination)
        edges = view.project(np.array([[-half, 0, 0.6], [half, 0, 0.6]]))[0][:, 0]
        columns = np.nonzero(mask)[1]
        assert columns.min() < edges[0] - 10 and columns.max() > edges[1] + 10
        # the base is drawn 2 mm narrower than the slab, the line is 2 pixels wide
        assert not ((columns > edges[0] + 2) & (columns < edges[1] - 3)).any()


def test_pictures_show_inclination_and_absence_of_the_platform():
    state = hovering()
    with make_renderer(W, H, "hero", "ray") as renderer:
        nominal = renderer.render(over(state))
        steep = renderer.render(over(state, -0.8))
        gone = renderer.render(pose_from_state(state, None))
        assert changed(steep, nominal).sum() > 500
        assert changed(gone, nominal).sum() > 500
        np.testing.assert_array_equal(renderer.render(over(state)), nominal)


def test_wrong_arguments_are_sentences():
    with pytest.raises(UserError, match="width must be a whole number from 16 to 4096, not 4"):
        make_renderer(4, 4, backend="ray")


def test_missing_opengl_is_one_sentence_with_the_remedy(monkeypatch):
    monkeypatch.setattr(gl_backend, "_loads", lambda *names: False)
    for _ in range(2):  # MuJoCo's own second attempt would abort the process
        with pytest.raises(UserError) as caught:
            make_renderer(W, H, backend="gl")
        message = str(caught.value)
        assert "libEGL and libGL and libOSMesa is missing" in message
        assert "apt-get install libegl1 libgl1" in message and "\n" not in message


def test_import_touches_neither_opengl_nor_learning():
    code = (
        "import os, sys; import inclined_landing.envs.rendering as r; r.make_renderer(64, 48, "
        "backend='ray'); bad = [m for m in ('OpenGL', 'torch', 'mujoco.egl') if m in sys.modules];"
        "assert not bad, bad; assert 'MUJOCO_GL' not in os.environ"
    )
    environment = {"PATH": "/usr/bin:/bin", "HOME": "/tmp"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


GL = """
import numpy as np
from inclined_landing.envs.rendering import make_renderer, pose_from_state, resting_platform
from inclined_landing.models.parameters import load_vehicle
state = np.zeros(13)
state[[0, 2, 7]] = 0.3, 1.6, 0.2
pose = pose_from_state(state, resting_platform(load_vehicle()))
frames = []
for backend in ("gl", "ray"):
    with make_renderer(640, 480, "hero", backend) as r:
        bare = r.render(pose, show_vehicle=False).astype(int)
        full = r.render(pose, trail=r.centres([state, state]), ghosts=[], caption="").astype(int)
        frames.append(np.abs(full - bare).sum(axis=2)[:320] > 60)
gl, ray = frames
print((gl & ray).sum() / (gl | ray).sum())
"""


@pytest.mark.gl
def test_opengl_shows_the_vehicle_at_the_same_pixels():
    try:
        gl_backend._kind()
    except UserError:
        pytest.skip("no OpenGL on this machine")
    done = subprocess.run([sys.executable, "-c", GL], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    # shadows differ (soft, hard) and translucent discs too; the vehicle dominates
    assert float(done.stdout.split()[-1]) > 0.5
