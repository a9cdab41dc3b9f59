"""Policies sent by radio: over a bad link, to the simulated Crazyflie with the app's code, by the command."""

import functools
import heapq
import itertools
import struct
import threading

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

pytest.importorskip("cflib", reason="the extra fly is not installed")

from inclined_landing.eval import cli
from inclined_landing.eval.export import compiled, contract, policy_file
from inclined_landing.eval.export.command import write
from inclined_landing.eval.flying.simulated.crazyflie import fly_simulated
from inclined_landing.eval.flying.simulated.faults import Fault
from inclined_landing.eval.flying.simulated.onboard import OnboardApp
from inclined_landing.eval.flying.simulated.radio import LinkQuality
from inclined_landing.eval.flying.simulated.server import SimulatorServer
from inclined_landing.eval.flying.simulated.world import Setting, World
from inclined_landing.eval.flying.upload import policy_bytes, upload
from inclined_landing.models.errors import UserError
from tests.policies import about_another_hover

pytestmark = pytest.mark.skipif(compiled.compiler() is None, reason="no C compiler on this machine")
PLAIN, LONG = "landing-nominal", "landing"  # which needs more memory


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export") / "c"
    write(contract.load(PLAIN), "c", folder)
    return folder


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A policy of the same contract."""
    return about_another_hover(PLAIN, tmp_path_factory.mktemp("other"))


@pytest.fixture(scope="module")
def file(other):
    return policy_bytes(other)


class BadLink:
    """An app channel into a compiled export, with its own clock: packets get lost, doubled and late."""

    def __init__(self, app, random, *, lost=0.0, doubled=0.0, late=0.0):
        self.app, self.random, self.time = app, random, 0.0
        self.lost, self.doubled, self.late = lost, doubled, late
        self.appchannel = self.packet_received = self
        self.queue, self.count, self.sent = [], itertools.count(), 0

    def add_callback(self, callback):
        self.callback = callback

    def send_packet(self, packet):
        assert len(packet) <= 30
        self.sent += 1

        def arrive():
            if reply := self.app(packet, False):
                self.travel(lambda: self.callback(reply))

        self.travel(arrive)

    def travel(self, arrive):
        for _ in range(1 + (self.random.random() < self.doubled)):
            if self.random.random() >= self.lost:
                delay = self.random.exponential(0.1) if self.random.random() < self.late else 0.004
                heapq.heappush(self.queue, (self.time + delay, next(self.count), arrive))

    def now(self):
        return self.time

    def wait_until(self, moment):
        while self.queue and self.queue[0][0] <= moment:
            self.time, _, arrive = heapq.heappop(self.queue)
            arrive()
        self.time = moment


def acts(app):
    """First bytes of the hash of the policy that acts, as the app says."""
    return app(b"\3\0\0", False)[8:]


@functools.cache
def app_of(folder):
    """One app for all examples."""
    return OnboardApp(folder).start()


share = st.sampled_from([0.0, 0.05, 0.3])


@hypothesis.settings(max_examples=15)
@hypothesis.given(seed=st.integers(0, 2**32 - 1), lost=share, doubled=share, late=share)
def test_a_bad_link_delays_an_upload_and_nothing_else(folder, file, seed, lost, doubled, late):
    """15 attempts of a question that fails with 1 - 0.7^2: once in 25 000."""
    app = app_of(folder)
    link = BadLink(app, np.random.default_rng(seed), lost=lost, doubled=doubled, late=late)
    progress = []
    for content in (policy_bytes_of_landing(folder), file):
        upload(link, link, content, progress.append)
        assert acts(app) == content[-32:][:8]
    if lost == late == 0.0:  # a begin, a commit, chunks of 24 bytes, and a question for each eight
        chunks = -(-len(file) // 24)
        assert link.sent == 2 * (2 + chunks + -(-chunks // 8))
    assert progress[-1] == len(file)


def policy_bytes_of_landing(folder):
    return (folder / policy_file.NAME).read_bytes()


def test_the_file_of_an_export_is_what_is_uploaded(folder):
    assert policy_bytes(PLAIN) == policy_bytes_of_landing(folder) == policy_bytes(str(folder / "policy.bin"))


def test_packets_of_another_upload_or_none_change_nothing(folder, file, tmp_path):
    app = compiled.Library(folder, tmp_path, "-O1").receive
    key, mine = file[-32:][:16], file[-32:][:2]
    received = lambda reply: int.from_bytes(reply[4:8], "little")  # noqa: E731
    begin, commit = struct.pack("<BI", 1, len(file)) + key, b"\4" + key
    chunk = lambda k, id=mine: b"\2" + id + struct.pack("<H", k) + file[24 * k : 24 * k + 24]  # noqa: E731
    before = acts(app)
    assert app(commit, False)[1] == app(b"\3" + mine, False)[1] == policy_file.Answer.NO_UPLOAD
    assert app(begin, True)[1] == policy_file.Answer.FLYING and app(chunk(0), False) == b""
    assert app(begin, False)[1] == 0
    for packet in (
        b"",
        b"\0",
        b"\5" + mine,
        b"\3",
        chunk(1),
        chunk(0)[:-1],
        chunk(0) + b"x",
        chunk(0, b"\0\0"),
        begin[:-1],
    ):
        assert app(packet, False) == b"", packet
        assert received(app(b"\3" + mine, False)) == 0
    app(chunk(0), True)  # in flight
    assert received(app(b"\3" + mine, False)) == 0
    for k in (0, 0, 2, 1, 0):
        app(chunk(k), False)
    assert received(app(b"\3" + mine, False)) == received(app(begin, False)) == 48
    assert app(commit, False)[1] == policy_file.Answer.NO_UPLOAD  # not all of it is there
    for k in range(-(-len(file) // 24)):
        app(chunk(k), False)
    assert app(commit, True)[1] == policy_file.Answer.FLYING and acts(app) == before
    assert app(commit, False)[1] == app(commit, False)[1] == 0  # the first reply may have got lost
    assert acts(app) == key[:8]
    # Begun with one size and hash, and filled with something else.
    assert app(struct.pack("<BI", 1, 48) + bytes(16), False)[1] == 0
    for k in (0, 1):
        app(chunk(k, b"\0\0"), False)
    assert app(b"\4" + bytes(16), False)[1] == policy_file.Answer.LENGTH and acts(app) == key[:8]


def connected(folder, seed=1, faults=(), **setting):
    setting = Setting(heading=0.0, app=OnboardApp(folder), **setting)
    flight = fly_simulated(setting, seed=seed, faults=[Fault.parse(text) for text in faults])
    flight.crazyflie.open_link(flight.uri)
    return flight


def send(flight, content):
    upload(flight.crazyflie, flight.clock, content, lambda received: None)


def test_a_simulated_crazyflie_takes_policies_on_the_ground_alone(folder, file):
    flight = connected(folder, link=LinkQuality(lost=0.05))
    app = flight.world.services.app
    send(flight, file)
    assert acts(app) == file[-32:][:8]
    with pytest.raises(
        UserError, match="larger than this firmware has memory for; there the one with SHA-256"
    ):
        send(flight, policy_bytes(LONG))
    for thrust in (0, *[38000] * 50):
        flight.crazyflie.commander.send_setpoint(0, 0, 0, thrust)
        flight.clock.wait_until(flight.clock.now() + 0.02)
    with pytest.raises(
        UserError, match="no policy is loaded while the vehicle flies; .* " + file[-32:][:8].hex()
    ):
        send(flight, policy_bytes(PLAIN))


def test_a_restart_forgets_what_was_loaded_and_a_lost_link_is_said(folder, file):
    flight = connected(folder)
    compiled_one = acts(flight.world.services.app)
    send(flight, file)
    flight.world.reboot()
    assert acts(flight.world.services.app) == compiled_one
    with pytest.raises(UserError, match="no app for policies answers"):
        send(flight, file)


def test_without_an_app_or_an_export_a_sentence_says_so(file, tmp_path):
    flight = fly_simulated(Setting(heading=0.0), seed=1)
    flight.crazyflie.open_link(flight.uri)
    with pytest.raises(UserError, match="no app for policies answers"):
        send(flight, file)
    with pytest.raises(UserError, match="is no C export"):
        OnboardApp(tmp_path)


@pytest.mark.parametrize(
    ("policy", "sentence"),
    [
        ("{here}/none.bin", "none.bin"),
        ("{here}/text.bin", "this is not a policy file"),
        ("{here}/damaged.bin", "the file is damaged"),
        ("{here}/old.bin", "format version 7, not 1"),
        ("landing", "--uri must look like"),
    ],
)
def test_wrong_input_is_one_sentence(policy, sentence, file, tmp_path, capsys):
    (tmp_path / "text.bin").write_bytes(b"a policy")
    (tmp_path / "damaged.bin").write_bytes(file[:-1] + bytes([file[-1] ^ 1]))
    (tmp_path / "old.bin").write_bytes(file[:8] + b"\7" + file[9:])
    uri = "nonsense" if policy == "landing" else "udp://127.0.0.1:1"
    assert cli.main(["upload", policy.format(here=tmp_path), f"--uri={uri}"]) == 2
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1


def test_the_command_over_udp(folder, other, file, capsys):
    server = SimulatorServer(
        World(Setting(app=OnboardApp(folder)), seed=1), 0, ("127.0.0.1", 9), lambda line: None
    )
    done = threading.Event()

    def serve():
        while not done.is_set():
            server.run(0.05)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        assert cli.main(["upload", other, f"--uri=udp://127.0.0.1:{server.port}"]) == 0
        assert f"SHA-256 {file[-32:].hex()[:16]}" in capsys.readouterr().out
        assert acts(server.world.services.app) == file[-32:][:8]
    finally:
        done.set()
        thread.join()
        server.close()
