"""Exported policies: every format answers as the policy does, and its contract says what goes in and out."""

import ctypes
import dataclasses
import importlib.util
import itertools
import json
import re
import shutil
import subprocess
from importlib import resources
from pathlib import Path

import jsonschema
import numpy as np
import onnxruntime
import pytest

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.history import History
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.tasks import InclinedLanding, make_task
from inclined_landing.envs.tasks.base import COLUMNS
from inclined_landing.eval import cli
from inclined_landing.eval.export import c_source, contract, onnx_file, vectors
from inclined_landing.eval.export.command import FORMATS, write
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from tests.policy_files import Spaces, pilot, restamp, written

POLICIES = ("landing-nominal", "landing", "setpoint", "touchdown-nominal")
# float32 sums of 64 products of size 1 at 6e-8 each, through two layers and a gain of about 3: some 1e-6.
TOLERANCE = 1e-5
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow")
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
NO_COMPILER = pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")


def build(sources, out, *flags):
    """Compile sources into `out` as C99 without warnings."""
    done = subprocess.run([COMPILER, *STRICT, *sources, *flags, "-o", out], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


class Library:
    """The compiled policy of a C export; `folder` is one, `scratch` an empty folder to compile in."""

    def __init__(self, folder: Path, scratch: Path, *flags: str):
        source = folder / "src"
        sources = [source / "landing_policy.c", Path(__file__).with_name("c_code") / "rows.c"]
        path = build(sources, scratch / "policy.so", f"-I{source}", "-shared", "-fPIC", *(flags or ("-O2",)))
        self._library = ctypes.CDLL(str(path))

    def infer(self, inputs: np.ndarray, actions: int) -> np.ndarray:
        """Actions (n, a) for inputs (n, i), history included."""
        inputs = np.ascontiguousarray(inputs, np.float32)
        result = np.zeros((len(inputs), actions), np.float32)
        code = self._library.landing_policy_infer_rows(_pointer(inputs), _pointer(result), len(inputs))
        assert code == 0
        return result

    def call(self, name: str, *arrays: np.ndarray) -> int:
        """Result of a function of the header for arrays that it reads or writes."""
        return getattr(self._library, name)(*map(_pointer, arrays))


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Every shipped kind of policy in every format: folders by policy and format."""
    root = tmp_path_factory.mktemp("exported")
    folders = {}
    for name in POLICIES:
        policy = contract.load(name)
        tested, terms = vectors.record(policy), contract.describe(policy)
        for format, make in FORMATS.items():
            folder = root / f"{name}-{format}"
            folder.mkdir()
            importlib.import_module(make).write(folder, contract.single(policy), terms, tested)
            (folder / "vectors.json").write_text(storage.to_json(tested.table()))
            (folder / "contract.json").write_text(storage.to_json(terms))
            folders[name, format] = folder
    return folders


@pytest.fixture(scope="module")
def libraries(exported, tmp_path_factory):
    """The compiled C exports by policy."""
    return {name: Library(exported[name, "c"], tmp_path_factory.mktemp("build")) for name in POLICIES}


def session(folder):
    return onnxruntime.InferenceSession(folder / "policy.onnx", providers=["CPUExecutionProvider"])


def answers(folder, format, library=None):
    """A function from whole inputs (n, i) to actions (n, a) of an export."""
    actions = len(json.loads((folder / "contract.json").read_text())["action"])
    if format == "c":
        return lambda inputs: library.infer(inputs, actions)
    run = session(folder).run
    return lambda inputs: run(None, {"input": np.asarray(inputs, np.float32)})[0]


@dataclasses.dataclass
class Driver:
    """Flies an export where a policy would fly, and compares every action with the policy's."""

    policy: Policy
    answer: object
    worst: float = 0.0

    @property
    def task(self):
        return self.policy.task

    def predict(self, inputs):
        actions = self.answer(inputs)
        self.worst = max(self.worst, np.abs(actions - self.policy.predict(inputs)).max())
        return actions


@pytest.mark.parametrize("format", [*FORMATS])
@pytest.mark.parametrize("name", POLICIES)
@NO_COMPILER
def test_an_export_is_the_policy_in_a_thousand_states_and_along_whole_flights(
    exported, libraries, name, format
):
    policy, answer = contract.load(name), answers(exported[name, format], format, libraries[name])
    rng = np.random.default_rng(5)
    inputs = policy.centre + 2.0 * policy.scale * rng.normal(size=(1000, len(policy.centre)))
    inputs = inputs.astype(np.float32)
    wanted = policy.predict(inputs)
    assert np.mean(np.abs(wanted) < 1.0) > 0.2  # it is not only the limits that agree
    np.testing.assert_allclose(answer(inputs), wanted, rtol=0.0, atol=TOLERANCE)
    driver = Driver(policy, answer)
    starts = policy.task.sample(np.random.default_rng(6), 3).state
    flown = record_flights(driver, "hybrid", starts)
    assert driver.worst < TOLERANCE
    alone = record_flights(policy, "hybrid", starts)
    assert [f.success for f in flown] == [f.success for f in alone]
    assert any(f.success for f in flown) or name == "setpoint"
    # Actions that differ by 1e-6 for seconds; a touchdown's contact multiplies that.
    apart = max(np.abs(a.state[:, :3] - b.state[: len(a.state), :3]).max() for a, b in zip(flown, alone))
    assert apart < (0.05 if name == "touchdown-nominal" else 1e-3)


@pytest.mark.parametrize("format", [*FORMATS])
@pytest.mark.parametrize("name", POLICIES)
@NO_COMPILER
def test_the_vectors_are_met_step_by_step(exported, libraries, name, format):
    folder, library = exported[name, format], libraries[name]
    table = {k: np.array(v) for k, v in json.loads((folder / "vectors.json").read_text()).items()}
    terms = json.loads((folder / "contract.json").read_text())
    assert np.abs(table["actions"]).max() == 1.0 and np.mean(np.abs(table["actions"]) < 1.0) > 0.3
    np.testing.assert_allclose(
        answers(folder, format, library)(table["inputs"]), table["actions"], rtol=0.0, atol=TOLERANCE
    )
    size, width = terms["input"]["history"]["steps"], len(terms["action"])
    if format == "c":
        memory = np.zeros(1 + size * (table["observations"].shape[1] + width), np.float32)
        action, command = np.zeros(width, np.float32), np.zeros(4, np.float32)
        for _ in range(2):
            library.call("landing_policy_reset", memory)
            for row, wanted, told in zip(*(table[k] for k in ("observations", "actions", "commands"))):
                assert library.call("landing_policy_act", memory, row.astype(np.float32), action) == 0
                np.testing.assert_allclose(action, wanted, rtol=0.0, atol=TOLERANCE)
                assert library.call("landing_policy_command_of", wanted.astype(np.float32), command) == 0
                np.testing.assert_allclose(command, told, rtol=1e-6)  # float: 6e-8 of the larger term
        assert library.call("landing_policy_self_test") == 0


@NO_COMPILER
def test_what_is_not_finite_is_refused_or_nan(exported, libraries):
    name = "landing"
    library, size = libraries[name], 26
    memory, action = np.zeros(1 + 21, np.float32), np.full(2, 7, np.float32)
    run = session(exported[name, "onnx"]).run
    good = np.array([0.5, 1.5, 0.1, 0.0, 0.1], np.float32)
    library.call("landing_policy_act", memory, good, np.zeros(2, np.float32))
    before = memory.copy()
    for k in range(5):
        for wrong in (np.nan, np.inf, -np.inf):
            bad = good.copy()
            bad[k] = wrong
            assert library.call("landing_policy_act", memory, bad, action) == 1
            assert (action == 7).all() and (memory.view(np.int32) == before.view(np.int32)).all()
            rows = np.zeros((2, size), np.float32)
            rows[0, :5] = bad
            answer = run(None, {"input": rows})[0]
            assert np.isnan(answer[0]).all() and np.isfinite(answer[1]).all()
    command = np.full(4, 7, np.float32)
    assert library.call("landing_policy_command_of", np.array([np.nan, 0], np.float32), command) == 1
    assert (command == 7).all()


@NO_COMPILER
def test_the_c_code_is_small_allocates_nothing_and_has_a_constant_stack(exported, tmp_path):
    for name in POLICIES:
        source = exported[name, "c"] / "src"
        out = build(
            [source / "landing_policy.c"], tmp_path / "policy.o", f"-I{source}",
            *("-c", "-Os", "-fstack-usage", "-fno-stack-protector", "-fcf-protection=none"),
        )  # fmt: skip
        assert out.stat().st_size < c_source.SMALL
        symbols = subprocess.run(["nm", out], capture_output=True, text=True, check=True).stdout
        missing = {line.split()[1] for line in symbols.splitlines() if line.split()[0] == "U"}
        assert missing <= {"memcpy", "memset", "memmove", "_GLOBAL_OFFSET_TABLE_"}
        changing = [line for line in symbols.splitlines() if line.split()[-2] in "bBdDC"]
        assert not changing  # nothing is kept between calls
        usage = [line.split("\t") for line in (tmp_path / "policy.su").read_text().splitlines()]
        assert all(kind == "static" for *_, kind in usage)
        said = int(re.search(r"(\d+) bytes of stack", (source / "landing_policy.h").read_text())[1])
        frames = {place.split(":")[-1]: int(size) for place, size, _ in usage}
        deepest = sum(frames[f"landing_policy_{f}"] for f in ("self_test", "act", "infer"))
        assert deepest <= said + 3 * 120  # what calls save on a 64-bit machine


@NO_COMPILER
def test_the_c_code_does_nothing_undefined(exported, tmp_path):
    flags = ("-O1", "-fsanitize=undefined", "-fno-sanitize-recover=all")
    source = exported["landing", "c"] / "src"
    check = exported["landing", "c"] / "check.c"
    try:
        build([check], tmp_path / "none.o", "-c", f"-I{source}", *flags)
        out = build([check, source / "landing_policy.c"], tmp_path / "check", f"-I{source}", *flags)
    except AssertionError as error:
        pytest.skip(f"no sanitizer: {error}")
    done = subprocess.run([out], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "the actions are those of the policy\n", "")


@NO_COMPILER
def test_a_changed_weight_fails_the_self_tests(exported, tmp_path):
    folder = shutil.copytree(exported["landing", "c"], tmp_path / "c")
    path = folder / "src/landing_policy.c"
    text = path.read_text()
    at = text.index("layer 3, 64 inputs: weights")
    changed = text[:at] + re.sub(r"\n    [-0-9.e]+f", "\n    1.5f", text[at:], count=1)
    path.write_text(changed)
    assert changed != text
    assert Library(folder, tmp_path).call("landing_policy_self_test") == 2


# --- the contract -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", POLICIES)
def test_the_contract_follows_its_schema(exported, name):
    file = resources.files("inclined_landing.eval.export").joinpath("contract.schema.json")
    schema = json.loads(file.read_text("utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    terms = json.loads((exported[name, "c"] / "contract.json").read_text())
    jsonschema.validate(terms, schema)
    wrong = terms | {"control_period": 0}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(wrong, schema)


@pytest.mark.parametrize("name", POLICIES)
def test_the_contract_alone_tells_what_the_vectors_hold(exported, name):
    """Inputs are built from names, commands from the action map, all by contract.json alone."""
    terms = json.loads((exported[name, "onnx"] / "contract.json").read_text())
    table = {
        k: np.array(v) for k, v in json.loads((exported[name, "onnx"] / "vectors.json").read_text()).items()
    }
    observed = [entry["name"] for entry in terms["observation"]]
    acted = [f"{entry['name']} command" for entry in terms["action"]]
    for k, row in enumerate(table["inputs"]):
        for number, said in zip(row, terms["input"]["names"]):
            word, back = re.fullmatch(r"(.*?)(?:\[-(\d+)\])?", said).groups()
            at = k - int(back or 0)
            if word in observed:
                expected = table["observations"][max(at, 0), observed.index(word)]
            else:
                expected = 0.0 if at < 0 else table["actions"][at, acted.index(word)]
            assert number == expected
    commands = np.zeros((len(table["actions"]), 4))
    for entry in terms["action"]:
        a = table["actions"][:, entry["index"]]
        command = np.clip(entry["centre"] + entry["span"] * a, entry["low"], entry["high"])
        commands[:, entry["column"]] = np.where(
            a <= (-2 if entry["idle"] is None else entry["idle"]), 0, command
        )
    np.testing.assert_allclose(commands, table["commands"], rtol=1e-12)
    states = dict(zip(COLUMNS, table["states"].T))
    for k, word in enumerate(observed):
        np.testing.assert_allclose(table["observations"][:, k], states[word], rtol=1e-6, atol=1e-6)


# Names with these would end or begin a C comment, contain a trigraph for a backslash, or continue a line.
HOSTILE = "harmless */ int x; /* y *?/ int z; ??/", "a\nb */ int x; \u202e", "*??/\\"


@NO_COMPILER
@pytest.mark.parametrize("name", HOSTILE)
def test_a_policy_s_name_does_not_leave_its_comment(tmp_path, name):
    terms, tested = contract.describe(load_policy("landing")), vectors.record(load_policy("landing"))
    terms["policy"]["name"] = name
    c_source.write(tmp_path, contract.single(load_policy("landing")), terms, tested)
    sources = tmp_path / "check.c", tmp_path / "src/landing_policy.c"
    build(sources, tmp_path / "check", "-trigraphs", f"-I{tmp_path / 'src'}")
    for line in (tmp_path / "src/landing_policy.h").read_text().splitlines()[:1]:
        assert line.startswith("/* Policy ") and "*/" not in line and not line.endswith("\\")


def test_the_contract_is_the_task_the_metadata_and_the_vehicle():
    policy = contract.load("landing")
    terms, task = contract.describe(policy), policy.task
    assert terms["control_period"] == load_vehicle().command_control_period
    assert terms["task"]["goal"]["z"] == task.goal[1]
    inside = np.zeros((2, 13))
    inside[:, [0, 2, 3, 5, 7]] = task.goal + 0.999 * np.array([*terms["task"]["goal_half_widths"].values()])
    inside[1, 0] *= 1.01
    assert task.in_goal(inside, task.goal_size).tolist() == [True, False]
    assert terms["policy"]["training"]["command"] == policy.metadata["command"]
    assert [entry["unit"] for entry in terms["observation"]] == ["m", "m", "m/s", "m/s", "rad"]


# --- policies of other sizes and kinds ------------------------------------------------------------------


class Named(InclinedLanding):
    """Its observations have names that would end a comment in C."""

    name = "named"
    observation_names = tuple(f"*/ {name} /*" for name in InclinedLanding.observation_names)


@NO_COMPILER
@pytest.mark.parametrize(("hidden", "more"), [
    ((7, 40), {"activation": "ReLU"}),
    ((13, 1), {"activation": "Tanh", "squashed": True, "bound": 2.0, "limit": 10.0}),
])  # fmt: skip
def test_networks_of_other_sizes_and_kinds(hidden, more, tmp_path):
    rng, task = np.random.default_rng(1), Named(history=1)
    sizes = [5 + 5 + 2, *hidden, 2]
    layers = list(itertools.pairwise(sizes))
    policy = Policy(
        **{"task": task, "metadata": {}, "path": Path(__file__), "limit": np.inf} | more,
        centre=rng.normal(size=sizes[0]),
        scale=rng.uniform(0.1, 3.0, sizes[0]),
        weights=tuple(2.0 / np.sqrt(n) * rng.normal(size=(n, m)) for n, m in layers),
        biases=tuple(0.3 * rng.normal(size=m) for _, m in layers),
    )
    tested = vectors.sequence(policy, np.zeros((8, 13)), rng.normal(scale=2.0, size=(8, 5)))
    terms = contract.describe(policy)
    for make in FORMATS.values():
        importlib.import_module(make).write(tmp_path, contract.single(policy), terms, tested)
    (tmp_path / "contract.json").write_text(storage.to_json(terms))
    inputs = rng.normal(scale=3.0, size=(50, sizes[0])).astype(np.float32)
    library = Library(tmp_path, tmp_path, "-O1")
    assert library.call("landing_policy_self_test") == 0
    # float32: 6e-8 for each of 4 layers, grown by gains of 2 and inputs of 30 scales
    for format in FORMATS:
        got = answers(tmp_path, format, library)(inputs)
        np.testing.assert_allclose(got, policy.predict(inputs), rtol=0.0, atol=5e-5, err_msg=format)


# --- the command --------------------------------------------------------------------------------------


def test_the_command_writes_a_whole_folder(tmp_path, capsys):
    for format, files in {"c": {"check.c", "src"}, "onnx": {"policy.onnx"}}.items():
        out = tmp_path / format
        assert cli.main(["export", "landing", "--format", format, "--out", str(out)]) == 0
        both = {"contract.json", "vectors.json"}
        assert {path.name for path in out.iterdir()} == files | both
    import onnx

    model = onnx.load(tmp_path / "onnx/policy.onnx")
    assert [(o.domain, o.version) for o in model.opset_import] == [("", onnx_file.OPSET)]
    notes = {entry.key: entry.value for entry in model.metadata_props}
    assert json.loads(notes["contract"]) == json.loads((tmp_path / "onnx/contract.json").read_text())
    source = (tmp_path / "c/src/landing_policy.c").read_text()
    again = write(contract.load("landing"), "c", tmp_path / "again")
    assert (tmp_path / "again/src/landing_policy.c").read_text() == source
    assert again["policy"]["name"] == "landing"


def test_what_a_format_cannot_hold_is_refused(tmp_path):
    wide = Policy(make_task("landing"), {}, Path(__file__), np.zeros(5), np.ones(5), np.inf,
                  (np.ones((5, 400)), np.ones((400, 400)), np.ones((400, 2))),
                  (np.zeros(400), np.zeros(400), np.zeros(2)), "ReLU")  # fmt: skip
    tested = vectors.sequence(wide, np.zeros((1, 13)), np.zeros((1, 5)))
    with pytest.raises(UserError, match="bytes of constants"):
        c_source.write(tmp_path, contract.single(wide), contract.describe(wide), tested)
    assert not [*tmp_path.iterdir()]
    with pytest.raises(UserError, match="beyond the range of float32"):
        contract.single(dataclasses.replace(wide, scale=np.full(5, 1e-300)))

    class OwnCommands(type(make_task("landing"))):
        def commands(self, actions):
            return super().commands(actions) * 0.9

    with pytest.raises(UserError, match="in its own way"):
        contract.describe(dataclasses.replace(wide, task=OwnCommands()))


def test_policies_of_sac_and_of_another_vehicle(tmp_path):
    from stable_baselines3 import SAC

    options = {"buffer_size": 1, "policy_kwargs": {"net_arch": [32, 16]}}
    network = SAC("MlpPolicy", Spaces(), seed=0, device="cpu", **options)
    path = tmp_path / "sac.zip"
    vehicle = {"command_control_period": 0.04, "body_mass": 0.035}
    written(path, network, {"task": "landing", "task_options": {"pwm_centre": 40000.0}, "vehicle": vehicle})
    policy = contract.load(str(path))
    assert policy.task.vehicle.body_mass == 0.035 and policy.task.pwm_centre == 40000.0
    terms = write(policy, "onnx", tmp_path / "out")
    assert terms["control_period"] == 0.04 and terms["vehicle"]["differences"] == vehicle
    rows = np.random.default_rng(1).normal(scale=2.0, size=(300, 5)).astype(np.float32)
    got = session(tmp_path / "out").run(None, {"input": rows})[0]
    np.testing.assert_allclose(got, network.predict(rows, deterministic=True)[0], rtol=0.0, atol=TOLERANCE)
    restamp(path, {"task": "landing", "task_options": {}, "vehicle": {"wings": 2}})
    with pytest.raises(UserError, match="unknown entry wings"):
        contract.load(str(path))


def test_what_a_policy_is_told_of_its_vehicle_is_part_of_its_export(tmp_path):
    """For the Hummingbird: the export is given the plain observation, and answers as the policy does."""
    vehicle = load_vehicle("hummingbird")
    task = make_task("landing", vehicle, observe_vehicle=True, pwm_centre="own")
    told = pilot(task)
    terms = write(told, "onnx", tmp_path / "out")
    assert terms["input"]["names"] == list(task.observation_names)
    assert terms["action"][0]["centre"] == pytest.approx(vehicle.hover_pwm)
    assert terms["vehicle"]["differences"]["body_mass"] == 0.5
    rows = np.random.default_rng(0).normal(scale=0.5, size=(20, 5)).astype(np.float32)
    inputs = History(task, 20).stack(rows)
    got = session(tmp_path / "out").run(None, {"input": rows})[0]
    np.testing.assert_allclose(got, told.predict(inputs), rtol=0.0, atol=TOLERANCE)
