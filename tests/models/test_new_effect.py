"""A new effect by docs/guides/extend.md: an entry in the library, and new physics in seven files."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from inclined_landing.envs import randomise
from inclined_landing.eval.gap.model.columns import Candidates
from inclined_landing.models.effects import LIBRARY, Effect, Parameter, apply
from inclined_landing.models.parameters import load_vehicle

ROOT = Path(__file__).parents[2]
V = load_vehicle()
ENTRY = """
    Effect(
        name="swirl",
        description="Across the air the rotors lean back.",
        formula="tau_y += c v_forward",
        source="a toy",
        parameters=(Parameter("c", unit="N s", bounds=(-1e-3, 1e-3), plausible=3e-4, negligible=1e-5),),
        regimes=("lateral",),
        confused_with=("estimator_lean",),
        remedy="Fly slowly.",
        channels=("attitude",),
        says="fast flight turns the vehicle ({c})",
    ),
"""
# File -> (what stands there, what follows it) for new physics: in every file of the guide, and its term.
WALK = {
    "models/crazyflie.toml": (
        "[effects]\n",
        'swirl = { value = 0.0, range = [-1.0, 1.0], unit = "N s", source = "neutral", uncertainty = 0 }\n',
    ),
    "models/vehicle.py": ("    effects_mocap_delay: float\n", "    effects_swirl: float\n"),
    "models/effects/air.py": ("EFFECTS = (", ENTRY),
    "envs/shipped/robust.toml": ("y = [-0.001, 0.001]\n", "\n[effects.swirl]\nc = [0.0, 3e-4]\n"),
}
ATTRIBUTE = 'swirl = { entry = "effects.swirl", meaning = "a toy" }\n'
TERMS = {
    "torque about z": {
        "models/plugin/attributes.toml": [("[rotors]\n", ATTRIBUTE)],
        "models/forces.py": [("    return fx, fy, fz + thrust, tx, ty", ", v.effects.swirl * bx")],
        "models/equations.py": [("    fx, fy, fz, tx, ty", ", air_tz"), ("        tz = 0.0", " + air_tz")],
        "models/plants/recorder.py": [("x, y, z, _, _", ", _")],
        "models/plugin/rotors.cc": [("centre[0] * lift;\n", "    moment[2] += config.swirl * air[0];\n")],
    },
    "loop": {
        "models/plugin/attributes.toml": [("[attitude]\n", ATTRIBUTE)],
        "models/attitude_loops.py": [
            (
                "    beyond = (v.attitude.damping - 1.0) * (v.attitude.bandwidth + 1.0 / tau)",
                " + 1e5 * v.effects.swirl * abs(rate)",
            ),
            ("    if integrates(v) or v.effects.attitude_saturation != 0.0", " or v.effects.swirl != 0.0"),
            ("    if v.effects.attitude_saturation == 0.0", " and v.effects.swirl == 0.0"),
        ],
        "models/plugin/attitude.cc": [
            (
                "(config->damping - 1) * (config->bandwidth + 1 / tau)",
                " + 1e5 * config->swirl * std::abs(rate)",
            ),
        ],
    },
}
# Run with Python's own interpreter of the kernels: compiled, a new layout of `Vehicle` takes minutes.
FLIGHT = """
import sys
sys.meta_path[:] = [finder for finder in sys.meta_path if "Scikit" not in type(finder).__name__]
import numpy as np
from inclined_landing.envs import randomise
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant

nominal = load_vehicle()
vehicle = LIBRARY["swirl"].apply(nominal, LIBRARY["swirl"].plausible)
ranges = randomise.read_ranges("robust")
assert list(ranges.effects) == [name for name in LIBRARY if name in ranges.effects]
assert any(v.effects_swirl for v in ranges.draw(nominal, 0, 64))

def end(kind, vehicle, **options):
    plant = make_plant(kind, 1, vehicle, attitude="rate_loop", **options)
    plant.set_platform([0], 0.0, False)
    state = np.zeros((1, 13))
    state[0, [2, 3, 4, 12]] = 1.5, 3.0, -1.0, vehicle.hover_lag
    plant.reset([0], state)
    for _ in range(25):
        plant.step(np.array([[vehicle.hover_pwm, 0.1, -0.1, 0.5]]))
    return plant.state[0, :9]

engine = end("mujoco", vehicle, threads=1)
for kind, options in {"analytic": {"substeps": 5}, "hybrid": {"threads": 1}}.items():
    assert np.abs(engine - end(kind, vehicle, **options)).max() < 1e-6, kind
assert np.abs(engine - end("mujoco", nominal, threads=1)).max() > 0.02
"""


@pytest.fixture
def wear(monkeypatch):
    """An effect on fields that the vehicle file has."""

    def worn(vehicle, values):
        share = 1.0 - values.get("wear", 0.0)
        return vehicle.changed(
            contact_friction=vehicle.contact_friction * share,
            attitude_time_constant=vehicle.attitude_time_constant / share,
        )

    effect = Effect(
        name="wear",
        description="Feet and bearings wear out together.",
        formula="mu times (1 - wear), tau over (1 - wear)",
        source="a toy",
        parameters=(Parameter("wear", bounds=(0.0, 0.5), plausible=0.1, negligible=0.01),),
        regimes=("attitude_step", "touchdown"),
        confused_with=("friction",),
        remedy="Replace them.",
        channels=("attitude", "touchdown"),
        apply=worn,
        says="feet and bearings are worn by {wear}",
    )
    monkeypatch.setitem(LIBRARY, "wear", effect)
    return effect


def test_an_entry_of_the_library_is_enough_for_fields_that_are_there(wear, tmp_path):
    worn = apply(V, {"wear": {"wear": 0.1}})
    assert worn.contact_friction == 0.9 * V.contact_friction and apply(V, {"wear": {}}) == V
    (tmp_path / "worn.toml").write_text("[effects.wear]\nwear = [0.1, 0.1]\n")
    assert randomise.read_ranges(tmp_path / "worn.toml").draw(V, 0, 2) == [worn, worn]
    candidates = Candidates.for_vehicle(V, LIBRARY)
    (column,) = candidates.columns(["wear"])
    moved, step = candidates.one_sided_difference({}, column)
    assert moved == apply(V, {"wear": {"wear": step}})


@pytest.mark.skipif(
    shutil.which("cmake", path="/usr/bin:/bin") is None, reason="no cmake to build the plugins with"
)
@pytest.mark.parametrize("kind", TERMS)
def test_new_physics_takes_the_seven_files_of_the_how_to(kind, tmp_path):
    walk = {file: [change] for file, change in WALK.items()} | TERMS[kind]
    manuals = [(ROOT / name).read_text("utf-8") for name in ("docs/guides/extend.md", "CONTRIBUTING.md")]
    for file in walk.keys() - {"models/effects/air.py"}:
        assert any(f"`{file}`" in text or f"`{Path(file).name}`" in text for text in manuals), file
    package = tmp_path / "inclined_landing"
    for folder in ("models", "envs"):
        shutil.copytree(ROOT / folder, package / folder, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "__init__.py").touch()
    for file, changes in walk.items():
        text = (package / file).read_text("utf-8")
        for there, more in changes:
            assert text.count(there) == 1, (file, there)
            text = text.replace(there, there + more)
        (package / file).write_text(text, "utf-8")
    sources, build = package / "models/plugin", tmp_path / "build"
    options = [f"-DPython3_EXECUTABLE={sys.executable}", "-DCMAKE_CXX_FLAGS=-O0"]  # quicker to compile
    for command in (
        ["cmake", "-S", sources, "-B", build, *options],
        ["cmake", "--build", build],
        ["cmake", "--install", build, "--prefix", package / "models"],
        [sys.executable, "-c", FLIGHT],
        [sys.executable, sources / "generate.py", "manual"],
    ):
        environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(tmp_path), "NUMBA_DISABLE_JIT": "1"}
        done = subprocess.run(command, capture_output=True, text=True, env=environment)
        assert done.returncode == 0, done.stdout + done.stderr
    assert "| `swirl` | `[effects] swirl` | N s |" in (sources / "README.md").read_text("utf-8")
