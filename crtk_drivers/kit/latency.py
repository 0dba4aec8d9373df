"""The latency timer of a USB serial adapter: how long it holds a short reply back before it passes it on.

FTDI adapters (U2D2, USB2DYNAMIXEL) come with 16 ms, which limits a chain to some 60 cycles a second; 1 ms is
the least. Linux shows it under /sys/bus/usb-serial, where root can set it; anyone who may open the port can
ask for low latency, which sets it as well.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

__all__ = ["Latency", "lower"]

_log = logging.getLogger(__name__)

BEST: Final = 1
_SYSFS: Final = Path("/sys/bus/usb-serial/devices")
_REMEDY: Final = (
    "Set it to 1 ms with the udev rule "
    '\'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{{latency_timer}}="1"\' '
    "in /etc/udev/rules.d/99-usb-serial-latency.rules, and plug the adapter in again; until then: "
    "echo 1 | sudo tee {file}"
)


@dataclass(frozen=True, slots=True)
class Latency:
    """The timer as it is now.

    Attributes:
        milliseconds: None if the adapter has no such timer, or the system does not tell.
        remedy: what to do about it; empty if nothing is to be done.
    """

    milliseconds: int | None
    remedy: str = ""


def read(device: Path, sysfs: Path = _SYSFS) -> int | None:
    """Return the timer in ms of a port such as /dev/ttyUSB0, None if it has none."""
    try:
        return int(_file(device, sysfs).read_text())
    except (OSError, ValueError):
        return None


def lower(device: Path, ask: Callable[[], None], sysfs: Path = _SYSFS) -> Latency:
    """Set the timer to 1 ms where that is permitted, and return what it is then.

    Args:
        device: the port, for example /dev/ttyUSB0; no symbolic link.
        ask: asks the port's driver for low latency (ASYNC_LOW_LATENCY); may raise OSError or ValueError.
        sysfs: where the ports of USB adapters are listed.
    """
    timer = read(device, sysfs)
    if timer is None:
        return Latency(None)
    file = _file(device, sysfs)
    if timer > BEST:
        try:
            file.write_text(str(BEST))
        except OSError as refused:
            _log.debug("%s: %s; asking the port for low latency", file, refused)
            try:
                ask()
            except (OSError, ValueError) as error:
                _log.debug("%s: %s", device, error)
        timer = read(device, sysfs)
    if timer is None or timer <= BEST:
        return Latency(timer)
    return Latency(timer, _REMEDY.format(file=file))


def _file(device: Path, sysfs: Path) -> Path:
    return sysfs / device.name / "latency_timer"
