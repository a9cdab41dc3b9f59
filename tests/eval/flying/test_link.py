"""Vehicles that cannot be reached: one sentence with the remedy, exit code 2, nothing on disk."""

import re

import pytest

pytest.importorskip("cflib", reason="the extra fly is not installed")

from inclined_landing.eval import cli
from inclined_landing.eval.flying import vehicle
from inclined_landing.eval.flying.vehicle import UDEV, check_uri
from inclined_landing.models.errors import UserError

RADIO = "radio://0/80/2M/E7E7E7E7E7"
GOOD = (
    *(RADIO, "radio://0/80", "radio://0/80/250K", "radio://12/0/1M", "radio://0/125/2M/00000000a1"),
    *("radio://e7e7e7e7e7/80/2M", RADIO + "?rate_limit=100", "usb://0", "udp://127.0.0.1:19850"),
)
BAD = (
    # scheme, dongle, channel, rate, address and query that are wrong, the rest being right
    *(RADIO.replace("radio:", f"{scheme}:") for scheme in ("", "RADIO", "http", "tcp", "serial", "udp")),
    *(f"radio://{dongle}/80/2M" for dongle in ("", "-1", "a", "0x0", "9999", "１", "0 ", "E7", "*")),
    *(f"radio://0/{channel}/2M" for channel in ("", "-1", "126", "1e1", "8.0", "８０", "9" * 5000, "80\n")),
    *(f"radio://0/80/{rate}" for rate in ("", "2m", "3M", "2MB", "250", "１M", "2M\0")),
    *(f"radio://0/80/2M/{address}" for address in ("", "E7", "E7E7E7E7E7E7", "G7E7E7E7E7", "Ｅ7E7E7E7E7")),
    *(RADIO + query for query in ("?", "?rate_limit=0", "?rate_limit=fast", "?safelink=0", "#here", "/")),
    *("radio", "radio://", "radio://0", "80/2M", "E7E7E7E7E7", "usb", "usb://", "usb://x", "usb://0/1"),
    *(
        "udp://",
        "udp://:19850",
        "udp://127.0.0.1",
        "udp://127.0.0.1:0",
        "udp://127.0.0.1:65536",
        "udp://[::1]:1",
    ),
    *(
        "udp://a@127.0.0.1:1",
        "udp://127.0.0.1:1/",
        "udp://a:1?x",
        "udp://a b:1",
        "",
        " ",
        "-",
        "/dev/ttyACM0",
    ),
    *(RADIO + " ", " " + RADIO, RADIO * 2, "é", "\u202e", "\0", "\n", "x" * 10_000, "\udcff", "😀://0"),
)


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
    assert cli.main(["fly", *words, "--mocap=poses:0.0.0.0:1", f"--out={folder / 'first'}"]) == 2
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
        ("usb://7", "no connection to usb://7: .*; is the vehicle connected by its cable"),
        ("udp://127.0.0.1:1", "no connection to .*; is a server such as"),
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
