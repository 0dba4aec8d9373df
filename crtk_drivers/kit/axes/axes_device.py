"""Axes of a controller, or of drives at one line, as a CRTK arm, whatever their protocol."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Literal

from typing_extensions import override

from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    Note,
    Setpoint,
    Severity,
    Steps,
)
from crtk_drivers.errors import (
    ConnectionLost,
    CrtkError,
    DeviceFault,
    TransitionFailed,
    raise_first,
)
from crtk_drivers.kit.axes.motion_controller import Complaint, MotionController
from crtk_drivers.kit.stream_goal import StreamGoal
from crtk_drivers.kit.waiting_steps import until
from crtk_drivers.samples import Sample
from crtk_drivers.state import OperatingState

__all__ = ["AxesDevice", "AxesOnClose"]

AxesOnClose = Literal["hold", "power_off"]


class AxesDevice(Device):
    """One arm.

    A fault is told until `enable` or `disable`. What moves when it is enabled, left by another session or
    begun by somebody else, is stopped first. Power that this driver switched on it takes away at the end, if
    `on_close` says so and the axes were seen to rest.

    Args:
        controller: its axes by their protocol.
        address: where it is.
        on_close: how axes are left at the end.
    """

    def __init__(self, controller: MotionController, address: str, on_close: AxesOnClose) -> None:
        self._controller = controller
        self._address = address
        self._on_close = on_close
        counting = controller.counting
        self._goal = StreamGoal(counting.lower, counting.upper, controller.blind)
        self._io: int | None = None
        self._gives_up = False
        self._switched_on = False  # by us, and not off since
        self._streams = False
        self._stops_aside = 0
        self._heard = -math.inf  # monotonic s at which what the last sample tells was so
        self._counts: Sequence[float] = ()  # of it
        self._trouble = self._found = ""

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._controller.capabilities

    @property
    @override
    def address(self) -> str:
        return self._address

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return self._controller.counters

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        at = [
            Note(Severity.WARNING, axis.name, axis.limit)
            for axis in self._controller.axes
            if axis.limit
        ]
        return (*self._controller.notes, *at)

    # --------------------------------------------------------------------------------------- the link

    @override
    def open(self, deadline: float) -> None:
        self._io = threading.get_ident()
        self._trouble, self._streams, self._heard, self._counts = "", False, -math.inf, ()
        self._controller.open(deadline, lambda: self._gives_up)
        self._found = self._found_state()

    @override
    def abort_open(self) -> None:
        self._gives_up = True

    def _found_state(self) -> str:
        axes = self._controller.axes
        moving = ", ".join(axis.name for axis in axes if axis.is_moving)
        powered = ", ".join(axis.name for axis in axes if axis.has_power)
        told = [f"{moving} moves"] if moving else []
        return "; ".join([*told, *([f"{powered} has power"] if powered else [])])

    @property
    @override
    def found(self) -> str:
        return self._found

    @override
    def close(self) -> None:
        controller = self._controller
        leaves_off = self._on_close == "power_off" and self._switched_on
        try:
            if self._switched_on and not controller.has_stopped:
                controller.lost()  # what waits behind an answer that does not come is not sent any more
        finally:
            controller.close(power_off=leaves_off and controller.has_stopped)

    @override
    def read(self, deadline: float) -> Sample | None:
        try:
            counted, fault = self._controller.exchange(deadline)
            if fault and not self._trouble:
                self._trouble, self._streams = fault, False
                self._controller.give_up()
        except ConnectionLost:
            if self._switched_on:
                self._controller.lost()
            raise
        if counted is None:
            return None
        stamp, positions, rates, efforts = counted
        self._heard, self._counts = stamp.monotonic, positions
        state = self._controller.counting.state(positions, rates, efforts)
        return Sample(stamp, {"measured_js": state})

    @property
    @override
    def condition(self) -> Condition:
        if self._trouble:
            return Condition(OperatingState.FAULT, self._trouble)
        return Condition()

    # ---------------------------------------------------------------------------------------- motion

    @override
    def write(self, setpoint: Setpoint) -> None:
        controller, now = self._controller, time.monotonic()
        is_blind = now - self._heard > controller.blind
        if self._trouble or is_blind or not controller.admits():
            return
        stops = self._stops_aside
        if not self._streams:  # also where another thread has stopped it just now
            self._goal.forget()
            self._streams = True
        here = controller.counting.positions(controller.here)
        goal = self._goal.lead(setpoint, here, now)
        controller.follow(now, controller.counting.counts(goal))
        if (
            self._stops_aside != stops
        ):  # this thread was held up, and its setpoint came after the stop
            self.stop()

    @property
    @override
    def has_arrived(self) -> bool:
        return self._controller.has_arrived

    @override
    def stop(self) -> None:
        self._streams = False
        aside = threading.get_ident() != self._io
        self._stops_aside += aside
        self._controller.halt(aside=aside)

    @property
    @override
    def has_stopped(self) -> bool:
        return self._controller.has_stopped

    @property
    @override
    def takes_setpoints(self) -> bool:
        return self._streams or self._controller.has_stopped

    # ------------------------------------------------------------------------------------------ state

    @contextmanager
    def _power_changes(self) -> Iterator[None]:
        """What axes tell is not judged meanwhile; it is again where that failed and all keep our power."""
        controller = self._controller
        controller.watch(False)
        try:
            yield
        except BaseException:
            if self._switched_on:
                controller.watch(all(axis.has_power for axis in controller.axes))
            raise

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        where = self._controller.where
        return tuple(
            DeviceFault(text, where=where, remedy=remedy)
            for text, remedy in (*self._controller.hindered, *self._astray())
        )

    def _astray(self) -> Iterator[Complaint]:
        """Yield which joints stand where none of their range can: with power, they would go on from there."""
        controller = self._controller
        counting = controller.counting
        astray = counting.astray(self._counts) if self._counts else {}
        for place, position in astray.items():
            can_be_homed = place in controller.homes
            if can_be_homed and not controller.is_homed:
                continue  # it counts from anywhere
            again = "Send unhome, enable and home." if can_be_homed else ""
            yield Complaint(
                f"joint {counting.names[place]} tells that it is at {position:.6g}, where no joint of its "
                f"range can stand ({counting.lower[place]:.6g} to {counting.upper[place]:.6g})",
                "Was it moved over the end of its counter, which has 32 bits? Move it back by hand, or check "
                f"its encoder, and the offset and range that are configured. {again}".strip(),
            )

    @override
    def enable(self) -> Steps:
        controller = self._controller
        raise_first(self.obstacles)
        self._trouble = ""
        with self._power_changes():
            if any(axis.is_moving for axis in controller.axes):
                self.stop()  # what another session has left, or somebody else began
                if not (yield from until(lambda: controller.has_stopped, controller.patience)):
                    raise self._failed(controller.words.goes_on)
            yield from controller.prepare()
            self._switched_on = True
            yield from controller.switch(True)
            has_power = yield from until(
                lambda: all(axis.has_power for axis in controller.axes), controller.patience
            )
            if not has_power:
                text, remedy = controller.without_power()
                yield from controller.switch(False)  # all of an arm has power, or nothing
                raise DeviceFault(text, where=controller.where, remedy=remedy)
        controller.watch(True)
        self._found = ""

    @override
    def disable(self) -> Steps:
        controller = self._controller
        with self._power_changes():
            yield from controller.switch(False)
            is_off = yield from until(
                lambda: all(axis.is_off for axis in controller.axes), controller.patience
            )
            if not is_off:
                raise self._failed(controller.words.stays_on)
        self._switched_on = False
        self._trouble = ""

    @property
    @override
    def is_homed(self) -> bool:
        return self._controller.is_homed

    @override
    def home(self) -> Steps:
        controller = self._controller
        for place in controller.homes:
            complaint = yield from controller.home(place)
            if complaint is not None:
                self.stop()
                what = f"joint {controller.counting.names[place]} was not homed: {complaint.text}"
                raise self._failed(Complaint(what, complaint.remedy))
        yield from controller.homed()

    @override
    def unhome(self) -> Steps:
        yield from self._controller.unhome()

    def _failed(self, complaint: Complaint) -> TransitionFailed:
        text, remedy = complaint
        return TransitionFailed(text, where=self._controller.where, remedy=remedy)
