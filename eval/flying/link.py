"""The URI of a vehicle: what it must look like, whether its radio is there, what to try without an answer."""

from __future__ import annotations

import re

from inclined_landing.eval.flying.pose_stream import resolved
from inclined_landing.models.errors import UserError, shown

FORMS = "radio://0/80/2M/E7E7E7E7E7 (Crazyradio, channel, rate, address), usb://0 or udp://127.0.0.1:19850"
UDEV = "https://www.bitcraze.io/documentation/repository/crazyflie-lib-python/master/installation/usb_permissions/"
CHANNELS = 125  # the highest: 2.525 GHz
_RADIO = re.compile(
    r"radio://(?P<dongle>[^/?#]*)/(?P<channel>[^/?#]*)"
    r"(?:/(?P<rate>[^/?#]*)(?:/(?P<address>[^/?#]*))?)?(?:\?rate_limit=[1-9][0-9]{0,5})?"
)
_PARTS = {  # of a radio's URI: their form, and what it is called
    "dongle": (r"[0-9]{1,3}|[0-9A-Fa-f]{10,32}", "a Crazyradio is 0, 1 ... or its serial number"),
    "channel": (r"[0-9]{1,3}", f"a channel is a number from 0 to {CHANNELS}"),
    "rate": (r"250K|1M|2M", "a rate is 250K, 1M or 2M"),
    "address": (r"[0-9A-Fa-f]{10}", "an address has ten hexadecimal digits, with its leading zeros"),
}
_REMEDIES = {
    "radio": "is the vehicle on, are channel, rate and address its own, and is the Crazyradio free?",
    "usb": "is the vehicle connected by its cable?",
    "udp": "does anything answer there, as `landing-eval crazyflie` does?",
}


def check_uri(uri: str) -> None:
    """Raise UserError for a URI that cflib does not understand or would misread.

    cflib flies an unknown rate at 2M, and puts zeros before a short address.
    """
    scheme = uri.partition("://")[0]
    if scheme == "radio" and (match := _RADIO.fullmatch(uri)):
        for name, (form, meaning) in _PARTS.items():
            part = match[name]
            wrong = part is not None and not re.fullmatch(form, part)
            if wrong or (name == "channel" and int(part) > CHANNELS):
                raise UserError(f"--uri: {meaning}, not {shown(repr(part), 40)}; {FORMS}")
    elif scheme == "udp" and (match := re.fullmatch(r"udp://([^/?#@:\s]+:[0-9]{1,5})", uri)):
        resolved(match[1])
    elif not re.fullmatch(r"usb://[0-9]{1,3}", uri):
        raise UserError(f"--uri must look like {FORMS}, not {shown(repr(uri), 60)}")


def find_radio(uri: str) -> None:
    """Raise UserError where the Crazyradio that `uri` names is not plugged in or cannot be opened."""
    match = _RADIO.fullmatch(uri)
    if match is None:
        return
    from cflib.drivers.crazyradio import get_serials

    try:
        serials = get_serials()
    except Exception as error:  # pyusb's and libusb's, whatever they are
        raise UserError(
            f"the Crazyradio cannot be opened ({shown(error, 100)}); on Linux udev rules give access: {UDEV}"
        ) from error
    dongle = match["dongle"]
    if not serials:
        raise UserError(
            f"no Crazyradio found: plug it in; if it is, udev rules give access to it on Linux: {UDEV}"
        )
    there = len(serials) > int(dongle) if len(dongle) < 10 else dongle.upper() in serials
    if not there:
        raise UserError(
            f"there is no Crazyradio {shown(dongle, 40)}: found 0 to {len(serials) - 1}, "
            f"serial numbers {shown(', '.join(map(str, serials)), 100)}"
        )


def remedy(uri: str) -> str:
    """Return advice for a vehicle that does not answer, as the end of a sentence; empty for test schemes."""
    hint = _REMEDIES.get(uri.partition("://")[0])
    return f"; {hint}" if hint else ""
