"""Watches the devices of other machines for the lab of this one, in a process of its own.

Run ``python -m crtk_drivers.client.lab_watch '{"arm": "/arm"}'`` with names and namespaces, in the
environment of the lab. It writes lines of `crtk_drivers.labs.seen` into the pipe of whoever started it, and
ends with it.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from typing import Final

from crtk_drivers.client.clock_watch import ClockWatch
from crtk_drivers.client.heard_devices import heard_devices
from crtk_drivers.errors import CrtkError
from crtk_drivers.labs.reports import STANDS_STILL, LinePipe, whoever_started
from crtk_drivers.labs.seen import Seen
from crtk_drivers.ros import environment
from crtk_drivers.samples import ClockOffset
from crtk_drivers.status.pulse import Pulse
from crtk_drivers.status.stop_request import StopRequest, stop_signals

__all__ = ["watch"]

PERIOD: Final = 1.0
"""Seconds between two lines of a device whose state is the same."""

LOOK_PERIOD: Final = 0.1
"""Seconds between two looks at what is due, and at whoever started this."""


@dataclass
class _Line:
    """What was written of a device, and when the next line is due."""

    told: tuple[bool, str, bool] = (False, "", False)
    due: float = 0.0


def watch(
    namespaces: Mapping[str, str], descriptor: int, pulse: Pulse | None, stop: StopRequest
) -> None:
    """Write how devices are, until nobody reads, whoever started this is gone, or `stop` is set.

    Args:
        namespaces: by the names of the devices.
        descriptor: of the pipe.
        pulse: of whoever reads; None: it is not listened for.
        stop: looked at again and again.

    Raises:
        MissingExtra, ConfigError: ROS 2 cannot be used here.
    """
    environment.check()
    environment.share_no_memory()
    from crtk_drivers.client.ros_link import Link  # what is not installed was told by `check`

    pipe, lines = LinePipe(descriptor), {name: _Line() for name in namespaces}
    changed = threading.Event()
    link = Link("crtk_lab_watch")
    with closing(link):
        devices = heard_devices(link, namespaces, changed.set)
        link.start()

        def there() -> list[str]:
            return [device.namespace for device in devices.values() if device.seen().seen]

        with closing(ClockWatch(link, there)) as clocks, suppress(BrokenPipeError):
            while not (stop.is_set() or _is_gone(pulse)):
                for name, device in devices.items():
                    offset = clocks.offset(device.namespace)
                    _write(pipe, lines[name], _with_offset(device.seen(), offset))
                changed.wait(LOOK_PERIOD)
                changed.clear()


def _is_gone(pulse: Pulse | None) -> bool:
    return pulse is not None and (pulse.silence() > STANDS_STILL or pulse.has_ended)


def _with_offset(seen: Seen, offset: ClockOffset | None) -> Seen:
    """Return how a device is with the offset of its clock, if it is seen and that is known."""
    if offset is None or not seen.seen:
        return seen
    return replace(seen, offset=offset.value, uncertainty=offset.uncertainty)


def _write(pipe: LinePipe, line: _Line, seen: Seen) -> None:
    """Write how a device is, if that is due, or it is otherwise than before."""
    told, now = (seen.seen, seen.state, seen.measures), time.monotonic()
    if (told != line.told or now >= line.due) and pipe.put(seen.line):
        line.told, line.due = told, now + PERIOD


def main(arguments: list[str]) -> int:
    """Watch for whoever started this process; return the exit code."""
    started = whoever_started()
    if started is None:
        sys.stderr.write("this is started by `crtk-driver up`, with a pipe to it\n")
        return 2
    with stop_signals() as stop:
        try:
            watch(json.loads(arguments[0]), *started, stop)
        except CrtkError as error:
            sys.stderr.write(f"{error}\n")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
