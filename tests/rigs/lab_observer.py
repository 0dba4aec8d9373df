"""The process that watches devices of other machines, as `up` starts it, and what it has written."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Final

from crtk_drivers.labs.reports import PULSE_FD, REPORT_FD
from crtk_drivers.labs.seen import Seen, read_seen
from crtk_drivers.status.pulse import Pulse, pulse_ends
from rigs.system_clock import shifted
from rigs.waiting import LONG, eventually

MODULE: Final = "crtk_drivers.client.lab_watch"


class Observer:
    """A running one. `seen` is all that it has written; what is not read stays in its pipe."""

    def __init__(self, process: subprocess.Popen[str], reading: int, pulse: Pulse) -> None:
        self.process = process
        self.pulse = pulse
        self.seen: list[Seen] = []
        self._reading = reading
        self._rest = b""

    def read(self) -> list[Seen]:
        """Return the lines that have come."""
        found, self._rest = read_seen(self._reading, self._rest)
        self.seen += found
        return found

    def until(self, what: str, **wanted: object) -> Seen:
        """Wait for a line that has these values; return it."""

        def found() -> Seen | None:
            assert self.process.poll() is None, "it has ended"
            has = (each for each in self.read() if _has(each, wanted))
            return next(has, None)

        seen: Seen = eventually(found, lambda: f"{what}; last: {self.seen[-3:]}")
        return seen

    def end(self) -> int:
        """Ask it to end; return the exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(LONG)


def _has(seen: Seen, wanted: Mapping[str, object]) -> bool:
    return all(
        value(getattr(seen, key)) if callable(value) else getattr(seen, key) == value
        for key, value in wanted.items()
    )


@contextmanager
def observer(
    namespaces: Mapping[str, str],
    python: Sequence[str] = (sys.executable, "-m"),
    environment: Mapping[str, str] | None = None,
) -> Iterator[Observer]:
    """Start one.

    Args:
        namespaces: by the names of the devices.
        python: what runs a module, maybe on another machine.
        environment: of it; None: that of this process.
    """
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    ours, theirs = pulse_ends()
    pulse = Pulse.start(ours)
    with theirs:
        files = {REPORT_FD: writing, PULSE_FD: theirs.fileno()}
        process = subprocess.Popen(
            [*python, MODULE, json.dumps(dict(namespaces))],
            env={
                **(environment or shifted(0.0)),
                **{name: str(file) for name, file in files.items()},
            },
            pass_fds=tuple(files.values()),
            text=True,
        )
    os.close(writing)
    with process:
        try:
            yield Observer(process, reading, pulse)
        finally:
            process.kill()
            pulse.close()
            os.close(reading)
