"""``crtk-driver hold``: stop a running device, and look until it stands."""

from __future__ import annotations

import time
from contextlib import suppress

from crtk_drivers.cli.reaching import STOP_TIMEOUT, need, place_of, why_not_standing
from crtk_drivers.cli.terminal import ERR, OUT, plain
from crtk_drivers.client import RemoteDevice
from crtk_drivers.errors import ConnectionFailed, CrtkError, DataTimeout, StopUnconfirmed


def hold(device: RemoteDevice) -> int:
    """Send `hold`, wait until the device is seen to stand, print that, and return 0.

    A device that reports neither its state nor where it is cannot be looked at: that is printed.

    Raises:
        ConfigError: it does not offer `hold`, as a sensor does not.
        CommandRefused: it refuses to.
        StopUnconfirmed: it was not seen to stand within `STOP_TIMEOUT`.
    """
    need(device, "hold")
    sent = time.monotonic()
    name = plain(device.namespace)
    with ERR.status(f"hold {name} ..."):
        has_state = _sent(device)
        place = place_of(device)
        if place:
            with suppress(CrtkError):  # what it does not report is told below
                device.add(place)  # to find it takes time of its own, once
        why = why_not_standing(device, STOP_TIMEOUT, has_state=has_state)
    if why:
        raise StopUnconfirmed(
            f"hold was sent, and it is not seen to stand after {time.monotonic() - sent:.1f} s: {why}",
            where=device.namespace,
            remedy="Send it again; if it moves on, press its emergency stop. "
            f"More: crtk-driver state {device.namespace}",
        )
    if place:
        OUT.print(f"{name}  stands, seen {time.monotonic() - sent:.1f} s after hold was sent")
    elif has_state:
        OUT.print(f"{name}  hold sent: it is not busy, and does not report where it is")
    else:
        OUT.print(f"{name}  hold sent, and not refused: it does not report whether it stands")
    return 0


def _sent(device: RemoteDevice) -> bool:
    """Send `hold`, and return whether an operating state is heard, of the device or of what it is a part of.

    Raises:
        CrtkError: it was refused, or could not be sent.
    """
    try:
        device.hold()
        device.add("operating_state")
    except DataTimeout:
        return False  # it is silent; hold goes out before it is waited for
    except ConnectionFailed:
        if "operating_state" in device.crtk_commands:
            raise
        return False
    return True
