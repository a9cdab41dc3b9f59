"""The page: recordings, scenes and the player in one self-contained file."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from importlib import resources
from typing import Any

import numpy as np
from markupsafe import Markup

from inclined_landing.eval.base.page import render
from inclined_landing.eval.pictures.path import select_copies
from inclined_landing.eval.replay.recording import Recording
from inclined_landing.eval.replay.scene import scene
from inclined_landing.models.attitude import ROLL, STATE_SIZE
from inclined_landing.models.base.errors import shown

MOST_ROWS = 30_000  # of all flights of a page: about 2 MB
_SCRIPTS = (
    "three/three.min.js",
    *(f"player/{name}.js" for name in ("data", "scene", "cameras", "curves", "player")),
)
_COPIES, _SPACING = 9, 0.2  # translucent copies along a flight, and how far apart they are at least [m]


def write(
    recordings: Sequence[Recording], *, title: str, notes: Sequence[str], run: str, versions: dict
) -> str:
    """Return the HTML of the page. run: the command that made it."""
    most = max(2, MOST_ROWS // len(recordings))
    downsampled = [recording.downsampled(most) for recording in recordings]
    for whole, part in zip(recordings, downsampled):
        if len(part.t) != len(whole.t):
            notes = [*notes, f"{whole.name}: {len(part.t)} of its {len(whole.t)} rows are in the page"]
    scenes: dict[tuple, dict] = {}
    flights = []
    for recording in downsampled:
        key = (recording.vehicle, recording.inclination, recording.azimuth)
        if key not in scenes:
            scenes[key] = scene(*key)
        flights.append(_encoded(recording) | {"scene": list(scenes).index(key)})
    content = {"flights": flights, "scenes": list(scenes.values())}
    return render(
        __package__,
        "player/replay.html.j2",
        title=title,
        flights=[(flight["name"], flight["outcome"]) for flight in flights],
        notes=notes,
        style=Markup(_file("player/replay.css")),
        scripts=[Markup(_file(name)) for name in _SCRIPTS],
        content=_as_script(content),
        run=run,
        versions=versions,
    )


def _file(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text("utf-8")


def _as_script(content: dict) -> Markup:
    """Return JSON that is safe inside a script element."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def _encoded(recording: Recording) -> dict[str, Any]:
    """Return a recording as JSON: columns as little-endian 32-bit floats in base 64, NaN included."""
    r = recording
    state = np.zeros((len(r.t), STATE_SIZE))
    state[:, :3], state[:, ROLL : ROLL + 3] = r.position, np.nan_to_num(r.attitude)
    encoded: dict[str, Any] = {
        "name": shown(r.name, 120),
        "kind": r.kind,
        "outcome": shown(r.outcome, 300),
        "rows": len(r.t),
        "events": [[round(t, 4), text] for t, text in r.events],
        "anew": r.restarts.tolist(),
        "copies": select_copies(state, _COPIES, _SPACING)[:-1].tolist(),
        "goal": None,
        "contacts": None,
    }
    for name in ("t", "position", "attitude", "velocity", "commands"):
        encoded[name] = _floats(getattr(r, name))
    if r.goal is not None:
        encoded["goal"] = {
            "position": r.goal[:3].tolist(),
            "attitude": r.goal[ROLL : ROLL + 3].tolist(),
            "size": r.goal_size,
        }
    if r.forces is not None and r.points is not None:
        counts = np.array([len(force) for force in r.forces], np.uint8)
        encoded["contacts"] = {
            "counts": base64.b64encode(counts.tobytes()).decode("ascii"),
            "points": _floats(np.concatenate(r.points)),
            "forces": _floats(np.concatenate(r.forces)),
        }
    return encoded


def _floats(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")
