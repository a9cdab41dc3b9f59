"""The replay page in a browser: what a person would do with it."""

import base64
import io
import shutil

import numpy as np
import pytest
from PIL import Image

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.tasks import hover_states
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.replay.measured import from_log
from inclined_landing.eval.replay.page import write
from inclined_landing.eval.replay.recording import from_flight
from inclined_landing.models.attitude import ROLL

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
HOSTILE = "<img src=x onerror=document.title='owned'>"
OPTIONS = [
    *("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
]

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian: apt-get install chromium)"),
]


@pytest.fixture(scope="module")
def browser():
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A page of a landing, and of a log of it with its simulation, under a hostile name."""
    policy = load_policy("landing-nominal")
    flight = record_flights(policy, "mujoco", hover_states([(1.5, 1.8)], policy.task.vehicle))[0]
    t, state = flight.t, flight.state
    log = FlightLog(HOSTILE, t, state[:, :3], state[:, ROLL : ROLL + 3], flight.commands)
    measured, notes = from_log(log, policy.task.vehicle, platform=True, horizon=0.5, plant="mujoco")
    path = tmp_path_factory.mktemp("replay") / "page.html"
    recordings = [from_flight(flight, "landing", "mujoco"), *measured]
    text = write(recordings, title=HOSTILE, notes=notes, run="a test", versions=runs.packages())
    path.write_text(text, "utf-8")
    return path


def opened(browser, file, before="", **options):
    """The page, ready, in a window of its own, and what it complained of so far."""
    context = browser.new_context(viewport={"width": 600, "height": 480}, **options)
    page = context.new_page()
    complaints = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda said: said.type in ("error", "warning") and complaints.append(said.text))
    page.on("request", lambda wanted: wanted.url.startswith("file:") or complaints.append(wanted.url))
    if before:
        page.add_init_script(before)
    page.goto(file.as_uri())
    page.wait_for_function("document.documentElement.dataset.ready")
    page.wait_for_function("!Replay.player.waiting")
    return page, complaints


@pytest.fixture(scope="module")
def page(browser, file):
    page, complaints = opened(browser, file)
    assert page.evaluate("document.documentElement.dataset.ready") == "3d"
    yield page
    # swiftshader's readback of the picture is slow, and Chromium says so
    assert [said for said in complaints if "ReadPixels" not in said] == []


def clock(page):
    return float(page.inner_text("#clock").split()[0])


def picture(page):
    """The canvas as numbers (h, w, 3)."""
    address = page.evaluate("Replay.player.draw(); document.getElementById('picture').toDataURL()")
    image = Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2])))
    return np.asarray(image.convert("RGB")).astype(int)


def differing(a, b):
    """Share of the pixels that are clearly different."""
    return (np.abs(a - b).max(axis=2) > 24).mean()


def test_play_moves_time_and_the_picture(page):
    page.evaluate("Replay.player.seek(0.2)")
    before = picture(page)
    page.click("#play")
    assert page.get_attribute("#play", "aria-label") == "pause"
    page.wait_for_function("Replay.player.time > 0.6")
    page.click("#play")
    at = clock(page)
    assert page.get_attribute("#play", "aria-label") == "play" and at >= 0.6
    assert differing(before, picture(page)) > 0.001
    page.wait_for_timeout(60)
    assert clock(page) == at


def test_every_camera_shows_another_picture(page):
    page.evaluate("Replay.player.seek(1.0)")
    seen = []
    for name in ("orbit", "follow", "side", "top", "pad"):
        page.click(f"#cameras [data-camera={name}]")
        assert page.get_attribute(f"#cameras [data-camera={name}]", "aria-pressed") == "true"
        seen.append(picture(page))
    shares = [differing(a, b) for k, a in enumerate(seen) for b in seen[:k]]
    assert min(shares) > 0.05


def test_names_stay_names(page):
    assert page.title() == HOSTILE and page.inner_text("h1") == HOSTILE
    assert HOSTILE in page.locator("#flights b").nth(1).inner_text()
    assert page.locator("img").count() == 0


def test_narrow_pages_do_not_scroll_sideways(page):
    page.set_viewport_size({"width": 390, "height": 700})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.set_viewport_size({"width": 600, "height": 480})


def test_without_webgl_a_sentence_and_the_curves_stay(browser, file):
    blind = (
        "const get = HTMLCanvasElement.prototype.getContext; HTMLCanvasElement.prototype.getContext = "
        "function (kind, ...rest) { return /^webgl/.test(kind) ? null : get.call(this, kind, ...rest); };"
    )
    page, _ = opened(browser, file, blind)
    assert page.evaluate("document.documentElement.dataset.ready") == "curves"
    assert "WebGL is missing" in page.inner_text("#flat") and not page.is_visible("#cameras")
    page.locator("#time").fill("0.5")
    assert clock(page) == 0.5 and page.locator(".cursor").count() >= 4
    page.context.close()
