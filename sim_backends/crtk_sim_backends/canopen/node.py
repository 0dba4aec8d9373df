"""Drives on a virtual bus: each is a node of it, woken by frames and by its timer."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import Any, Final

from crtk_sim_backends.can import frames
from crtk_sim_backends.can.hub import Hub
from crtk_sim_backends.can.port import DEAF, State
from crtk_sim_backends.canopen import injection
from crtk_sim_backends.canopen.aborts import SdoAbort
from crtk_sim_backends.canopen.drive import Drive, DriveConfig, Frame, eds_of
from crtk_sim_backends.canopen.nmt import INITIALISING, OPERATIONAL
from crtk_sim_backends.control import Handlers
from crtk_sim_backends.faults import Fault, KindTable
from crtk_sim_backends.kit.loop import Timer

_MAILBOXES: Final = 2  # frames of a drive that wait for the bus when SDO answers have to wait
_SOON: Final = 1e-4  # s that a timer may be later than asked for before it is set anew


class BusDrive:
    """A drive as a node of the bus.

    Args:
        hub: the bus.
        drive: the drive.
        happened: called with the name of what has happened to it.
    """

    def __init__(self, hub: Hub, drive: Drive, happened: Callable[[str], object]) -> None:
        self.drive = drive
        self.lost = 0  # frames that the bus did not take
        self._hub = hub
        self._happened = happened
        self._seen = INITIALISING, False, False, False
        self._bus_state = State(0)
        self._answers: deque[Frame] = deque()  # SDO frames that wait
        self._node = hub.add(f"drive-{drive.node_id}", self)
        self._timer: Timer | None = hub.call_at(time.monotonic(), self.wake)

    def wake(self) -> None:
        """Do what is due, and come back when the next thing is."""
        now = time.monotonic()
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None
        self._send(self.drive.on_timer(now))
        self._note()
        self._settle()

    def deliver(self, raw: bytes) -> None:
        """Hear a frame of the bus."""
        can_id, data = frames.unpack(raw)
        now = time.monotonic()
        if self.drive.keep(can_id, data, now):
            return
        answers = self.drive.on_frame(can_id, data, now)
        if answers:
            self._send(answers)
        if self.drive.acts:
            self._hub.when_sent(self._act)
        else:
            if answers:
                self._note()
            self._settle()

    def _act(self) -> None:
        """Do what SYNC has made valid, now that the samples have left."""
        answers = self.drive.act(time.monotonic())
        if answers:
            self._send(answers)
        self._note()
        self._settle()

    def state_changed(self, state: State) -> None:
        """Take note of what the bus does to the drive's controller."""
        before, self._bus_state = self._bus_state, state
        if state & DEAF:
            self._answers.clear()
        self.drive.bus_changed(
            off=bool(state & DEAF),
            was_off=bool(before & DEAF),
            passive=bool(state & State.PASSIVE),
        )
        self.wake()

    def waiting(self, count: int) -> None:
        """Take note of how many frames wait for the bus: SDO answers follow when there are few."""
        if self._answers and count < _MAILBOXES:
            self._hub.call_at(time.monotonic(), self._send_answers)

    def _send(self, sent: list[Frame]) -> None:
        """Send frames, but hold back what would delay the process data: a block of an SDO upload."""
        for identifier, data in sent:
            if identifier == 0x580 + self.drive.node_id and (
                self._answers or self._hub.waiting(self._node) >= _MAILBOXES
            ):
                self._answers.append((identifier, data))
            elif self._node.send(identifier, data):
                self.lost += 1

    def _send_answers(self) -> None:
        while self._answers and self._hub.waiting(self._node) < _MAILBOXES:
            if self._node.send(*self._answers.popleft()):
                self.lost += 1

    def _settle(self) -> None:
        """Hear what the drive is interested in (no remote, error and extended frames), and be woken in time.

        A timer that comes too early is left as it is.
        """
        if self._node.interests is not self.drive.interests:
            self._node.interests = self.drive.interests
        due = self.drive.next_timer
        if self._timer is not None:
            if self._timer.at <= due + _SOON:
                return
            self._timer.cancel()
            self._timer = None
        if math.isfinite(due):
            self._timer = self._hub.call_at(due, self.wake)

    def _note(self) -> None:
        """Tell what has happened since the last call."""
        drive, before = self.drive, self._seen
        enabled = moving = faulted = False
        for axis in drive.axes:
            enabled = enabled or axis.machine.enabled
            moving = moving or axis.setpoint.velocity != 0.0
            faulted = faulted or axis.machine.faulted
        now = drive.state, enabled, moving, faulted
        if now == before:
            return
        self._seen = now
        if before[0] is INITIALISING and now[0] is not INITIALISING:
            self._happened("boot_up")
        if now[0] is OPERATIONAL and before[0] is not now[0]:
            self._happened("operational")
        names = ("enabled", "moving", "faulted")
        for name, was, is_now in zip(names, before[1:], now[1:], strict=True):
            if is_now and not was:
                self._happened(name)

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know of the drive."""
        drive = self.drive
        return {
            "nmt": drive.state.name.lower(),
            "lost": self.lost,
            "axes": [
                {
                    "state": axis.machine.state.name.lower(),
                    "statusword": axis.statusword(),
                    "controlword": axis.value(0x6040),
                    "mode": axis.shown(0x6061),
                    "error": axis.value(0x603F),
                    "position": axis.position,
                    "velocity": axis.velocity,
                    "torque": axis.shown(0x6077),
                    "revolutions": axis.revolutions,
                    "powered": axis.powered,
                }
                for axis in drive.axes
            ],
        }


class BusDrives:
    """All drives of a bus: their faults, their status, and requests about them."""

    kinds: KindTable = injection.KINDS
    events: Collection[str] = injection.EVENTS
    places: tuple[str, ...] = injection.PLACES

    def __init__(self, hub: Hub, configs: Mapping[int, DriveConfig]) -> None:
        self._hub = hub
        self._drives = {
            node: BusDrive(hub, Drive(node, config), self._tell) for node, config in configs.items()
        }
        self._begun: dict[int, list[Drive]] = {}  # by id of the fault
        self.handlers: Handlers = {"object": self._object, "eds": self._eds}

    def _tell(self, name: str) -> None:
        self._hub.happened(name)

    def chosen(self, fault: Fault) -> list[Drive]:
        """Drives that a fault is for.

        Raises:
            FaultError: there is no such node or axis.
        """
        return injection.chosen(self.all, fault)

    def begin(self, fault: Fault) -> None:
        """Let a fault of the drives begin.

        Raises:
            FaultError: there is no such node or axis.
        """
        drives = self.chosen(fault)
        self._apply(fault, drives, begin=True)
        if self.kinds[fault.kind].lasting:
            self._begun[id(fault)] = drives

    def end(self, fault: Fault) -> None:
        """Let a fault of the drives end, if it could begin."""
        self._apply(fault, self._begun.pop(id(fault), []), begin=False)

    def _apply(self, fault: Fault, drives: list[Drive], *, begin: bool) -> None:
        for drive in drives:
            injection.apply(drive, fault, begin, time.monotonic())
            self._drives[drive.node_id].wake()

    @property
    def all(self) -> list[Drive]:
        """The drives."""
        return [each.drive for each in self._drives.values()]

    def status(self) -> Mapping[str, Any]:
        """State of each drive by node-ID."""
        return {"drives": {str(node): each.status() for node, each in self._drives.items()}}

    # Requests on the control socket

    def _object(self, node: int, index: int, sub: int = 0, value: int | None = None) -> int:
        """Read a number of a drive past the bus, or write one past access rights and states.

        Raises:
            ValueError: there is no such number, or the drive can do nothing with the value.
        """
        dictionary = self._drive(node).dictionary
        if not dictionary.variable(index, sub).type.size:
            raise ValueError(f"object {index:04X}:{sub} is no number")
        if value is not None:
            if not isinstance(value, int):
                raise ValueError(f"object {index:04X}:{sub} is a whole number, not {value!r}")
            try:
                dictionary.force(index, sub, value)
            except SdoAbort as refusal:
                low, high = dictionary.range_of((index, sub))
                raise ValueError(
                    f"object {index:04X}:{sub} cannot be {value}: it is {low} to {high}, and what the drive "
                    f"can work with ({refusal})"
                ) from refusal
        return dictionary[index, sub]

    def _eds(self, node: int) -> str:
        """EDS of a drive."""
        return eds_of(self._drive(node).config)

    def _drive(self, node: int) -> Drive:
        if node not in self._drives:
            raise ValueError(f"there is no drive with node-ID {node}")
        return self._drives[node].drive
