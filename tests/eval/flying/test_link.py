"""The link through cflib: what its calls send and receive, and vehicles that cannot be reached."""

import re
import struct
from types import SimpleNamespace

import pytest

pytest.importorskip("cflib", reason="the extra fly is not installed")

from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogTocElement
from cflib.crazyflie.toc import Toc
from cflib.crtp.crtpstack import CRTPPacket

from inclined_landing.eval import cli
from inclined_landing.eval.flying import vehicle, watchdog
from inclined_landing.eval.flying.simulated.transport import LinkQuality
from inclined_landing.eval.flying.simulated.world import Setting, World
from inclined_landing.eval.flying.vehicle import UDEV, CflibLink, Radio, check_uri
from inclined_landing.models.base.errors import UserError

RADIO = "radio://0/80/2M/E7E7E7E7E7"
GOOD = (
    *(RADIO, "radio://0/80", "radio://0/80/250K", "radio://12/0/1M", "radio://0/125/2M/00000000a1"),
    *("radio://e7e7e7e7e7/80/2M", RADIO + "?rate_limit=100", "udp://127.0.0.1:19850"),
)
BAD = (
    # scheme, dongle, channel, rate, address and query that are wrong, the rest being right
    *(RADIO.replace("radio:", f"{scheme}:") for scheme in ("", "RADIO", "http", "tcp", "serial", "udp")),
    *(f"radio://{dongle}/80/2M" for dongle in ("", "-1", "a", "0x0", "9999", "１", "0 ", "E7", "*")),
    *(f"radio://0/{channel}/2M" for channel in ("", "-1", "126", "1e1", "8.0", "８０", "9" * 5000, "80\n")),
    *(f"radio://0/80/{rate}" for rate in ("", "2m", "3M", "2MB", "250", "１M", "2M\0")),
    *(f"radio://0/80/2M/{address}" for address in ("", "E7", "E7E7E7E7E7E7", "G7E7E7E7E7", "Ｅ7E7E7E7E7")),
    *(RADIO + query for query in ("?", "?rate_limit=0", "?rate_limit=fast", "?safelink=0", "#here", "/")),
    *("radio", "radio://", "radio://0", "80/2M", "E7E7E7E7E7", "usb", "usb://0"),
    *"udp:// udp://:19850 udp://127.0.0.1 udp://127.0.0.1:0 udp://127.0.0.1:65536 udp://[::1]:1".split(),
    *"udp://a@127.0.0.1:1 udp://127.0.0.1:1/ udp://a:1?x - /dev/ttyACM0".split(),
    *("udp://a b:1", "", " "),
    *(RADIO + " ", " " + RADIO, RADIO * 2, "é", "\u202e", "\0", "\n", "x" * 10_000, "\udcff", "😀://0"),
)


# --- what cflib makes of the calls -------------------------------------------------------------------


@pytest.fixture(params=[12, 11])
def sending(request, monkeypatch):
    """A link of cflib's Crazyflie without a radio, of two protocol versions, and the packets it sends."""
    crazyflie, packets = Crazyflie(), []
    monkeypatch.setattr(crazyflie.platform, "get_protocol_version", lambda: request.param)

    def send(packet):
        if packet.port != 15:  # cflib's own pings, from a thread of its own
            packets.append((packet.port, packet.channel, bytes(packet.data)))

    crazyflie.link = SimpleNamespace(send_packet=send, needs_resending=False)
    yield CflibLink(crazyflie), packets
    crazyflie.link_statistics.stop()


def test_a_set_point_is_packed_as_the_simulated_vehicle_receives_it(sending):
    link, packets = sending
    link.setpoint(3.3, -7.1, 20.0, 41_000)
    port, channel, data = packets.pop()
    assert (port, channel) == (3, 0) and data == struct.pack("<fffH", 3.3, 7.1, 20.0, 41_000)
    world, received = World(Setting(link=LinkQuality(lost=0.0)), seed=1), []
    world.firmware.receive_rpyt = lambda time, *values: received.append(values)
    world.setpoint(3.3, -7.1, 20.0, 41_000)
    world.wait_until(world.now() + 0.1)
    assert received == [struct.unpack("<fffH", data)]


@pytest.mark.filterwarnings("ignore:The supervisor subsystem")
def test_arming_stopping_and_the_watchdog_are_the_firmware_s_commands(sending):
    """Ports, channels and numbers of `crtp_supervisor.c`, and of what there was before protocol 12."""
    link, packets = sending
    link.arm(), link.notice(), link.stop(), link.emergency_stop()
    arm, notice, stop, emergency = packets
    new = link.crazyflie.platform.get_protocol_version() >= 12
    assert arm == ((9, 1, b"\x01\x01") if new else (13, 0, b"\x01\x01"))
    assert notice == ((9, 1, b"\x04") if new else (6, 1, b"\x04"))
    assert {stop, emergency} <= set(watchdog.STOPS), "the other process sends them too"


def test_logs_arrive_with_their_time_and_their_values(sending):
    link, packets = sending
    log, rows = link.crazyflie.log, []
    log.toc = Toc()
    for k, (name, kind) in enumerate((("pm.vbat", 7), ("supervisor.info", 2))):  # float, uint16_t
        log.toc.add_element(LogTocElement(k, bytes([kind]) + name.replace(".", "\0").encode() + b"\0"))
    with pytest.raises(KeyError):
        link.log("status", 100, ("pm.nothing",), lambda *row: rows.append(row))
    link.log("status", 100, ("pm.vbat", "supervisor.info"), lambda *row: rows.append(row))
    block = packets[-1][2][1]
    packet = CRTPPacket(data=bytes([block]) + (70_000).to_bytes(3, "little") + struct.pack("<fH", 3.5, 64))
    packet.set_header(5, 2)
    log._new_packet_cb(packet)
    assert rows == [(70_000, {"pm.vbat": 3.5, "supervisor.info": 64})]


@pytest.mark.parametrize(
    ("event", "words", "why"),
    [("connection_lost", ("too quiet",), "too quiet"), ("disconnected", (), "disconnected")],
)
def test_a_link_that_ends_says_why(sending, event, words, why):
    link, _ = sending
    radio = Radio(link, None, 0.5)
    link.crazyflie.connected.call(RADIO)
    assert link.connected and radio.lost is None
    getattr(link.crazyflie, event).call(RADIO, *words)
    assert radio.lost == why


# --- vehicles that cannot be reached -----------------------------------------------------------------


def is_a_sentence(text):
    return text.isprintable() and 20 < len(text) < 600


@pytest.mark.parametrize("uri", GOOD)
def test_what_cflib_flies_is_accepted(uri):
    check_uri(uri)


def test_what_cflib_would_refuse_or_misread_is_refused_in_a_sentence():
    for uri in BAD:
        with pytest.raises(UserError) as caught:
            check_uri(uri)
        assert is_a_sentence(str(caught.value)), uri


def refused(words, folder, capfd):
    """The sentence with which `fly` ends."""
    assert cli.main(["fly", *words, "--mocap=vicon:nowhere:cf", f"--out={folder / 'first'}"]) == 2
    said = capfd.readouterr().err
    assert "Traceback" not in said and said.count("\n") == 1 and is_a_sentence(said.strip()), said
    assert list(folder.iterdir()) == []
    return said


def test_the_command_says_what_a_uri_looks_like(tmp_path, capfd):
    assert RADIO in refused(["--uri=radio://0/200/2M/E7E7E7E7E7"], tmp_path, capfd)


@pytest.fixture
def positioned(monkeypatch):
    """Motion capture that is there, and little patience with the link."""
    monkeypatch.setattr(vehicle, "CONNECTING", 0.2)
    monkeypatch.setattr("inclined_landing.eval.flying.positions.open_capture", lambda *_: None)


@pytest.mark.parametrize(
    ("uri", "sentence"),
    [
        (RADIO, f"no connection to .*: Cannot find a Crazyradio Dongle; is the vehicle on.*{UDEV}"),
        ("udp://127.0.0.1:1", "no connection to .*; is a simulator of the firmware"),
    ],
)
def test_a_link_that_fails_is_one_sentence_without_tracebacks(uri, sentence, tmp_path, capfd, positioned):
    """By cflib's own drivers, which log tracebacks."""
    assert re.search(sentence, refused([f"--uri={uri}"], tmp_path, capfd))


def test_a_heading_may_be_given_to_either_side(tmp_path, capfd, positioned):
    for heading in ("-90", "-360", "270"):
        assert "no connection" in refused([f"--uri={RADIO}", f"--heading={heading}"], tmp_path, capfd)
    for heading in ("-361", "nan"):
        assert "--heading" in refused([f"--uri={RADIO}", f"--heading={heading}"], tmp_path, capfd)
