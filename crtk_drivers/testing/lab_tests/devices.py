"""The devices of a lab as a test has them: moved within what is allowed, watched and recorded."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Final

import pytest
from typing_extensions import override

from crtk_drivers.errors import CrtkError
from crtk_drivers.labs.bench.acquisition import Safety
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.calls import About
from crtk_drivers.labs.bench.conducting import DeviceOrder
from crtk_drivers.labs.bench.conductor import hosted
from crtk_drivers.labs.bench.taping import read_recording
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.bench.watch import Watch
from crtk_drivers.labs.lab_file import LabDevice
from crtk_drivers.samples import Value
from crtk_drivers.state import Status
from crtk_drivers.status.stop_request import StopRequest

__all__ = ["LabUnderTest", "Station", "TestedDevice"]

NEVER_REFUSED: Final = ("hold", "disable")
"""A stop needs no leave."""

HOMES: Final = ("home", "unhome")
"""What leads to motion that no space bounds."""

RECORDED_WITHIN: Final = 10.0
"""Seconds in which a recording is completed."""


class Station:
    """A device of the lab for a whole session: the process of its driver, and its simulator.

    Args:
        device: of the lab.
        doors: folder for the socket of its process.
        folder: of the run.
        locks: files of `locks.alone`.
        lost: called with it when it does not answer as it is to be held, or left.
        allowed: says why something may not be done to it, in words.

    Attributes:
        stopped: why it is not used any further; empty while it is.
    """

    def __init__(
        self,
        device: LabDevice,
        doors: Path,
        folder: Path,
        locks: tuple[int, ...],
        lost: Callable[[LabDevice], None],
        allowed: Callable[[Safety, About, LabDevice], str],
    ) -> None:
        self.device = device
        self.stopped = ""
        self._allowed = allowed
        order = DeviceOrder(
            name=device.name,
            plugin=device.plugin.name,
            values=device.values,
            sim=device.sim,
            sim_options=device.sim_options,
            space=device.entry.space,
        )
        self.host = hosted(order, doors, folder, locks, partial(lost, device))
        self.host.__enter__()
        self._about: About | None = None

    @property
    def about(self) -> About:
        """What it is, once it measures.

        Raises:
            CrtkError: it does not.
        """
        if self._about is None:
            self._about = self.host.about()
        return self._about

    def forbidden(self, safety: Safety) -> str:
        """Return why something may not be done to it; empty if it may."""
        return self._allowed(safety, self.about, self.device)

    def leave(self) -> None:
        """Hold and disable it if more was done to it than to read, and end its processes."""
        self.host.__exit__(None, None, None)


class TestedDevice(Bed):
    """A device of the lab in one test; see `Bed` for what can be done.

    A command that hardware may not be given skips the test, with the reason. When the test has ended, a
    device that was commanded is held and disabled.

    Args:
        station: the device.
        recording: file for all that happens to it in this test.
    """

    __test__ = False

    def __init__(self, station: Station, recording: Path) -> None:
        self.station = station
        self.recording = recording
        self.is_touched = False
        self._is_recording = True
        space = station.device.entry.space
        box = None if space is None else space.tool_box
        about = station.about
        watch = Watch(station.host.connected(), about, box, StopRequest(), station.host.lose)
        super().__init__(station.device.name, about, station.host.door, watch, 1.0)
        self._door.call("record", str(recording))
        # What may not be commanded is not stopped either: it stays as it was found.
        watch.start(moves=not station.forbidden(Safety.ENABLE))

    @override
    def submit(self, name: str, value: Value | None = None, stamp_ns: int = 0) -> None:
        """Send a CRTK command, such as ``servo_jp`` with a `JointState`.

        Raises:
            Refused: the device does not take it, with the reason.
            Tripped: the watch has stopped the device.
        """
        self._ask_leave(name, Safety.SMALL)
        super().submit(name, value, stamp_ns)

    @override
    def service(self, name: str) -> str:
        """Ask for a service of the device's own: one may power it, or start a program that moves it."""
        self._ask_leave(name, Safety.SMALL)
        return super().service(name)

    @override
    def command_state(self, text: str) -> Status:
        """Send a state command, and return the status that it led to."""
        self._ask_leave(text, Safety.ENABLE)
        return super().command_state(text)

    def trace(self) -> Trace:
        """End the recording of this test, and return what it has, each sample and event."""
        self._end_recording()
        return Trace.of(read_recording(self.recording))

    @property
    def tripped(self) -> str:
        """Why the watch stopped it; empty if it did not."""
        return self._watch.tripped

    @property
    def lateness(self) -> tuple[float, ...]:
        """By how many seconds each look of the watch was late: how busy this machine is."""
        return tuple(self._watch.lateness)

    def end(self) -> str:
        """Hold and disable it if it was commanded, and end watch and recording; return what went wrong."""
        if self.is_touched:
            self.station.host.settle()
        self._watch.close()
        try:
            self._end_recording()
        except CrtkError as error:
            return str(error)
        return ""

    def _end_recording(self) -> None:
        if self._is_recording:
            self._is_recording = False
            self._door.call("stop_recording", within=RECORDED_WITHIN)

    def _ask_leave(self, command: str, safety: Safety) -> None:
        if command in NEVER_REFUSED:
            return
        forbidden = self.station.forbidden(safety)
        if command in HOMES and not self.station.device.simulated:
            forbidden = "moves as it likes, which is not done to hardware"
        if forbidden:
            pytest.skip(f"{self.name}: {command}: {forbidden}")
        self.is_touched = True
        self.station.host.is_touched = True


class LabUnderTest:
    """The fixture ``lab``: the devices of the lab by name, ``lab.arm`` or ``lab["arm"]``.

    A device is started when it is first asked for, and runs until the session ends.

    Attributes:
        name: of the lab.
        folder: of this run.
        features: what else stands in the lab, as the lab file says.
    """

    def __init__(
        self,
        name: str,
        folder: Path,
        features: Mapping[str, bool | float | str],
        device: Callable[[str], TestedDevice],
    ) -> None:
        self.name = name
        self.folder = folder
        self.features = features
        self._device = device

    def __getitem__(self, name: str) -> TestedDevice:
        return self._device(name)

    def __getattr__(self, name: str) -> TestedDevice:
        if name.startswith("_"):
            raise AttributeError(name)
        with contextlib.suppress(KeyError):
            return self._device(name)
        raise AttributeError(f"there is no device {name!r} in the lab {self.name!r}")
