"""Everything that reads a file or a folder reads it, or refuses it in one sentence, whatever is in it.

An entry of `READERS` is all that a new kind of file needs: good files, what reads them, what then must hold.
"""

import dataclasses
import functools
import gzip
import io
import json
import os
import re
import tempfile
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import given

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.tasks import make_task
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.eval import cli
from inclined_landing.eval.gap.model.reference import read_reference
from inclined_landing.eval.landings.run import design
from inclined_landing.eval.landings.study import read_study
from inclined_landing.eval.logs import FlightLog, limits, motion, read_log
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS, make_plant
from inclined_landing.train import cli as train
from inclined_landing.train.checkpoint import CHECKPOINT
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.run import Run
from inclined_landing.train.sweep.recipe import read_recipe
from inclined_landing.train.sweep.recipe import shipped as shipped_recipes
from tests import ROOT
from tests.campaign import damage, inputs
from tests.log_files import firmware_values, sd_card, write_bag

POLICY = (resources.files("inclined_landing.envs") / "shipped" / "landing.zip").read_bytes()
WEIGHTS, PICKLED = "policy.pth", "archive/data.pkl"
# What Stable-Baselines3 alone would have written.
PLAIN = damage.zipped([(n, b) for n, b in damage.members(POLICY).items() if n in ("data", WEIGHTS)])
ARRAY = "network/weights_1.npy"


@dataclasses.dataclass(frozen=True)
class Reader:
    """A kind of file or folder."""

    good: Callable[[], dict[str, bytes]]  # files by path
    take: Callable[[Path], object]  # reads what lies in a folder
    works: Callable[[object], None] = lambda result: None
    more: tuple[damage.Change, ...] = ()  # to its file
    places: tuple[str, ...] = tuple(damage.PLACES)  # what may stand in the place of a file


def text(name: str, content: str) -> Callable[[], dict[str, bytes]]:
    """Return what makes one file of text."""
    return lambda: {name: content.encode()}


def flies(vehicle) -> None:
    """0.1 s from hover stay finite in all plants."""
    for kind in PLANTS:
        plant = make_plant(kind, 1, vehicle)
        position = np.array([[1.0, 0.5, vehicle.platform_surface_height + 0.5]])
        plant.reset(np.arange(1), hover_states(position, vehicle))
        command = np.array([[min(vehicle.hover_pwm, vehicle.command_pwm_range[1]), 0.0, 0.0, 0.0]])
        for _ in range(10):
            plant.step(command)
        assert np.isfinite(plant.state).all() and np.abs(plant.state).max() < 1e7


def is_flown_by(policy) -> None:
    """Actions of any observation are within their bounds; five steps from a hover are finite."""
    rows = np.random.default_rng(0).normal(scale=10.0, size=(20, len(policy.centre)))
    assert (np.abs(policy.predict(rows)) <= 1.0).all()
    states = hover_states(np.array([[1.0, 0.0, 1.9]]), policy.task.vehicle)
    assert np.isfinite(record_flights(policy, "mujoco", states, steps=5)[0].state).all()


def load_plain(folder: Path):
    """Return the policy of a file of Stable-Baselines3 alone."""
    return load_policy(folder / "p.zip", make_task("landing", history=3, pwm_span=25_000))


def is_a_flight(log) -> None:
    """It is finite where it was logged, with an even grid of bounded size."""
    assert np.isfinite(log.position).all() and len(log) < 10_000
    for force in motion.motion(log).force:
        assert np.isfinite(force).all() and len(force) < 100_000


def is_drawn(study) -> None:
    """Every landing has its parameters and its start."""
    drawn, start = design(study)
    assert len(start) and all(np.isfinite(drawn[parameter.name]).all() for parameter in study.parameters)


def is_a_posterior(reference) -> None:
    """Mean and covariance are finite numbers of as many columns."""
    n = len(reference.columns)
    assert reference.mean.shape == (n,) and reference.covariance.shape == (n, n)
    assert np.isfinite(reference.mean).all() and np.isfinite(reference.covariance).all()


@functools.cache
def a_log() -> FlightLog:
    """Return the good flight."""
    with tempfile.TemporaryDirectory() as place:
        (Path(place) / "log.csv").write_text(FLIGHT)
        return read_log(Path(place) / "log.csv")


@functools.cache
def a_bag(ros: int) -> dict[str, bytes]:
    """Return the files of a bag of ROS 1 or 2."""
    with tempfile.TemporaryDirectory() as place:
        path = write_bag(Path(place, "log.bag" if ros == 1 else "log"), a_log(), ros)
        return {str(p.relative_to(place)): p.read_bytes() for p in ([path] if ros == 1 else path.iterdir())}


@functools.cache
def a_training() -> dict[str, bytes]:
    """Return the files of a run that was stopped after its first checkpoint."""
    with tempfile.TemporaryDirectory() as place:
        tiny = "--environments 2 --rollout 4 --batch-size 8 --steps 160 --epochs 1 --threads 1"
        tiny += " --max-seconds 1e-6 --evaluate-every 0 --no-report"
        damage.command(train.main, ["landing", *tiny.split(), "--out", place + "/run"])
        files = {str(p.relative_to(place)): p.read_bytes() for p in Path(place).rglob("*") if p.is_file()}
        return {f"run/{name}": files[f"run/{name}"] for name in (CHECKPOINT, "run.json")}


def elsewhere(words: str) -> Callable[[Path], str]:
    """Return what runs landing-eval on a folder and writes somewhere else."""

    def run(folder: Path) -> str:
        with tempfile.TemporaryDirectory() as away:
            filled = words.replace("{folder}", str(folder)).replace("{out}", f"{away}/out")
            return damage.command(cli.main, filled.split())

    return run


class Harmful:
    """Leaves a folder behind where it is unpickled."""

    def __reduce__(self):
        return os.mkdir, ("harm",)


# What a tensor of the network may be.
TENSORS = {
    "one more axis": lambda t: t[None],
    "one row less": lambda t: t[:-1].clone(),
    "expanded": lambda t: t.flatten()[:1].expand(1_000_000_000),
    "a huge stride": lambda t: t.as_strided((1, *t.shape), (2**62, *t.stride())),
    "complex": lambda t: t.to(torch.complex64),
    "sparse": lambda t: t.to_sparse(),
    "meta": lambda t: t.to("meta"),
    "NaN": lambda t: torch.full_like(t, torch.nan),
    "a number": lambda t: 1.0,
}


def weights(content: bytes, change) -> bytes:
    """Return a policy file of other tensors: `change` to every second one."""
    tensors = torch.load(io.BytesIO(damage.members(content)[WEIGHTS]), weights_only=True)
    out = io.BytesIO()
    torch.save({n: change(t) if k % 2 else t for k, (n, t) in enumerate(tensors.items())}, out)
    return damage.with_member(content, WEIGHTS, lambda _: out.getvalue())


NETWORKS = tuple(damage.Change(n, functools.partial(weights, change=change)) for n, change in TENSORS.items())
# What an array of the network may be instead, in a policy file.
ARRAYS = {
    "objects": lambda a: np.array([Harmful()], object),
    "integers": lambda a: a.astype(int),
    "complex": lambda a: a.astype(complex),
    "text": lambda a: a.astype(str),
    "one more axis": lambda a: a[None],
    "columns first": lambda a: np.asfortranarray(a),
    "one row less": lambda a: a[:-1],
    "NaN": lambda a: np.full_like(a, np.nan),
    "1e300": lambda a: np.full(a.shape, 1e300),
}
HEADERS = {  # of an array's file
    "states terabytes": b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000), }",
    "states exabytes": b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 100000000), }",
    "states less than nothing": b"{'descr': '<f8', 'fortran_order': False, 'shape': (-4, 2), }",
    "calls": b"{'descr': __import__('os').mkdir('harm'), 'fortran_order': False, 'shape': (1,), }",
    "nested": b"[" * 5000,
}


def array(content: bytes, change) -> bytes:
    """Return a policy file of which one array is another."""
    out = io.BytesIO()
    before = np.load(io.BytesIO(damage.members(content)[ARRAY]))
    np.lib.format.write_array(out, change(before), allow_pickle=True)
    return damage.with_member(content, ARRAY, lambda _: out.getvalue())


def headed(content: bytes, header: bytes) -> bytes:
    """Return a policy file of which one array has this header."""
    written = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(64)
    return damage.with_member(content, ARRAY, lambda _: written)


OWN_NETWORKS = (
    *(damage.Change(n, functools.partial(array, change=change)) for n, change in ARRAYS.items()),
    *(damage.Change(n, functools.partial(headed, header=header)) for n, header in HEADERS.items()),
)
RUN = {
    "run/run.json": b'{"config": {"task": "landing"}}',
    "run/learning.csv": b"steps,level,episode_length,episode_reward\n8192,0.1,40,-60\n16384,0.2,50,-50\n",
    "run/evaluations.csv": b"steps,score,strict_success\n8192,0.5,0.4\n16384,0.75,0.7\n",
}
VEHICLE = (resources.files("inclined_landing.models") / "crazyflie.toml").read_text("utf-8")
VEHICLES, LEE = ROOT / "models" / "vehicles", "crazyflie-2.1-lee"
RECIPE = shipped_recipes()["landing"].read_text("utf-8")
FLIGHT = inputs.flight()
READERS = {
    "vehicle": Reader(text("v.toml", VEHICLE), lambda f: load_vehicle(f / "v.toml"), flies),
    "ranges": Reader(
        text("r.toml", inputs.RANGES), lambda f: read_ranges(f / "r.toml").draw(load_vehicle(), 0, 3)
    ),
    "study": Reader(text("s.toml", inputs.STUDY), lambda f: read_study(f / "s.toml"), is_drawn),
    "recipe": Reader(text("r.toml", RECIPE), lambda f: read_recipe(f / "r.toml").runs()),
    "posterior": Reader(
        lambda: {name: (VEHICLES / name).read_bytes() for name in (f"{LEE}.toml", f"{LEE}.posterior.json")},
        lambda f: read_reference(f / f"{LEE}.toml", load_vehicle(f / f"{LEE}.toml"))[0],
        is_a_posterior,
    ),
    "mapping": Reader(
        lambda: {"m.toml": inputs.MAPPING.encode(), "log.csv": FLIGHT.encode()},
        lambda f: read_log(f / "log.csv", mapping=f / "m.toml"),
        is_a_flight,
    ),
    "log": Reader(text("log.csv", FLIGHT), lambda f: read_log(f / "log.csv"), is_a_flight),
    "packed log": Reader(
        lambda: {"log.csv.gz": gzip.compress(FLIGHT.encode())},
        lambda f: read_log(f / "log.csv.gz"),
        is_a_flight,
    ),
    "card": Reader(
        lambda: {"log": sd_card(firmware_values(a_log()), a_log().t, 2, {"pm.state": 1.0})},
        lambda f: read_log(f / "log"),
    ),
    "bag of ROS 1": Reader(lambda: a_bag(1), lambda f: read_log(f / "log.bag")),
    "bag of ROS 2": Reader(lambda: a_bag(2), lambda f: read_log(f / "log"), places=("nothing", "a folder")),
    "policy": Reader(
        lambda: {"p.zip": POLICY}, lambda f: load_policy(f / "p.zip"), is_flown_by, OWN_NETWORKS
    ),
    "policy of SB3": Reader(lambda: {"p.zip": PLAIN}, load_plain, is_flown_by, NETWORKS),
    "training": Reader(a_training, lambda f: Run(TrainConfig(out=f / "run", resume=True))),
    "curves": Reader(lambda: RUN, elsewhere("curves {folder}/run --out {out}.png")),
    "report": Reader(
        lambda: {"report.json": json.dumps(inputs.REPORT).encode()}, elsewhere("plan {folder} --out {out}")
    ),
}


def judged(reader: Reader, name: str, change: Callable[[bytes], bytes] | None, put=None) -> str:
    """Return what becomes of good files of which one is changed, or something else is put in its place.

    A refusal names a file or the folder that it is in.
    """
    with tempfile.TemporaryDirectory() as place:
        for path, content in reader.good().items():
            (Path(place) / path).parent.mkdir(parents=True, exist_ok=True)
            (Path(place) / path).write_bytes(change(content) if change and path == name else content)
        if put is not None:
            damage.replace(Path(place) / name, put)
        said = damage.used_or_refused(Path(place), lambda: reader.take(Path(place)), reader.works)
        names = {part for path in reader.good() for part in Path(path).parts}
        assert not said or any(part in said for part in names), f"names no file: {said}"
        return said


@pytest.fixture(autouse=True)
def small_logs(monkeypatch):
    """Reading 1 GB, the limit of a log, takes seconds: only with CAMPAIGN."""
    if "CAMPAIGN" not in os.environ:
        monkeypatch.setattr(limits, "LARGEST", 2**26)


@pytest.mark.parametrize("kind", READERS)
@damage.examples(5)
@given(data=st.data())
def test_files_are_used_or_refused(kind, data):
    reader = READERS[kind]
    name = data.draw(st.sampled_from(list(reader.good())))
    ways = [damage.changes(reader.good()[name]), st.sampled_from(reader.places)]
    ways += [st.sampled_from(reader.more)] if reader.more else []
    way = data.draw(st.one_of(ways))
    if isinstance(way, str):
        judged(reader, name, None, damage.PLACES[way])
    else:
        judged(reader, name, way.of)


@pytest.mark.parametrize("kind", READERS)
def test_good_files_are_used(kind):
    assert judged(READERS[kind], "", None) == ""


@pytest.mark.parametrize("kind", ["policy", "policy of SB3"])
def test_nothing_in_the_network_of_a_policy_is_executed(kind, tmp_path, monkeypatch):
    """Every change that a network's data may suffer, one after the other."""
    monkeypatch.chdir(tmp_path)
    refused = {change.name: judged(READERS[kind], "p.zip", change.of) for change in READERS[kind].more}
    assert not (tmp_path / "harm").exists()
    assert {name for name, sentence in refused.items() if not sentence} <= {"columns first", "a huge stride"}


def test_nothing_in_a_checkpoint_is_executed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    array, saved = io.BytesIO(), io.BytesIO()
    np.lib.format.write_array(array, np.array([Harmful()], object), allow_pickle=True)
    torch.save(Harmful(), saved)
    packed = damage.zipped([("state.json", b"{}"), ("a.npy", array.getvalue())])
    for content in (saved.getvalue(), packed):
        assert CHECKPOINT in judged(READERS["training"], f"run/{CHECKPOINT}", lambda _, c=content: c)
    assert not (tmp_path / "harm").exists()


def test_tensors_that_do_not_fit_a_run_are_refused():
    for part, name in (("policy", "one row less"), ("plant", "complex"), ("optimizer", "sparse")):

        def change(content, part=part, name=name):
            saved, out = torch.load(io.BytesIO(content), weights_only=True), io.BytesIO()
            tensors = saved[part] if part != "optimizer" else next(iter(saved[part].values()))
            tensors |= {key: TENSORS[name](tensor) for key, tensor in tensors.items() if tensor.ndim}
            torch.save(saved, out)
            return out.getvalue()

        assert CHECKPOINT in judged(READERS["training"], f"run/{CHECKPOINT}", change)


def test_child_processes_import_nothing_from_the_current_folder():
    """In the source: every Python that is started has -P."""
    started = re.compile(r"""sys\.executable,\s*"-\S+\s*(\S+)""")
    files = [f for place in ("envs", "eval", "train", "docs", ".ci") for f in (ROOT / place).rglob("*.py")]
    found = [(file, match[0]) for file in files for match in started.finditer(file.read_text("utf-8"))]
    assert len(found) >= 6 and not [call for call in found if '"-P",' not in call[1]]


def test_nothing_is_called_that_executes_what_a_file_holds():
    """In the source: readers of others that unpickle, and shells."""
    wrong = re.compile(
        r"\b(PPO|SAC|TD3|joblib|cloudpickle|pickle|marshal|shelve)\.(load|loads|open)\("
        r"|\btorch\.load\((?!.*weights_only=True\))"
        r"|allow_pickle=True|read_pickle|yaml\.(unsafe_|full_)?load\(|shell=True"
    )
    files = [file for folder in ("models", "envs", "eval", "train") for file in (ROOT / folder).rglob("*.py")]
    assert files and not [(file, match) for file in files for match in wrong.findall(file.read_text("utf-8"))]
