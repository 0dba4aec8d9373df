"""A gripper as a CRTK device, whatever its protocol: one joint, or none where it has channels."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Hashable, Mapping
from functools import partial
from typing import Final, Literal

from typing_extensions import override

from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Answer,
    Capabilities,
    Condition,
    Device,
    Goal,
    Input,
    Mode,
    MoveProgress,
    Note,
    Reading,
    Service,
    Setpoint,
    Severity,
    Steps,
)
from crtk_drivers.errors import (
    CommandRefused,
    CrtkError,
    DeviceError,
    DeviceFault,
    MotionAborted,
    PluginError,
    Reason,
    TransitionFailed,
    raise_first,
    with_remedy,
)
from crtk_drivers.kit.gripping.doing import EMPTY, HELD, ON_ITS_WAY, Doing, Weight
from crtk_drivers.kit.gripping.hand import Hand, HandService, When
from crtk_drivers.kit.gripping.smoothed_rate import SmoothedRate
from crtk_drivers.kit.waiting_steps import until
from crtk_drivers.samples import Flag, JointState, Sample, Text, Value, vector
from crtk_drivers.state import OperatingState

__all__ = ["GripperDevice", "OnClose"]

log = logging.getLogger(__name__)

OnClose = Literal["hold", "release", "nothing"]

STANDS: Final = 3.0
"""Seconds in which it must rest after a stop."""
FAREWELL: Final = 3.0
"""Seconds in which it must take the order to let go."""
PIECE: Final = 0.05
"""Seconds of an exchange, where many may be needed."""


class GripperDevice(Device):
    """One gripper.

    It may be moved, and let go, from the end of `enable` on until `disable`, `pause`, a lost link, a fault or
    a condition that does not allow it: by setpoints, moves, services, and by the end of the program.

    Args:
        hand: the gripper by its protocol.
        address: where it is.
        on_close: how it is left when the program ends.
        settling: time constant in s of a velocity that is found from positions.

    Raises:
        PluginError: a service of the hand is no `HandService`.
    """

    def __init__(self, hand: Hand, address: str, on_close: OnClose, settling: float = 0.1) -> None:
        for name, service in hand.services.items():
            if not isinstance(service, HandService):
                raise PluginError(
                    f"service {name!r} of {type(hand).__name__}: is a {type(service).__name__}, "
                    "must be a HandService (crtk_drivers.kit.gripping)",
                    where=address,
                )
        self._hand = hand
        self._address = address
        self._on_close = on_close
        self._rate = SmoothedRate(settling)
        self._asked: Hashable | None = None
        self._closing = self._is_enabled = self._may_move = self._may_hold = False
        self._is_made_ready = self._is_left = False
        self._io: int | None = None

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._hand.capabilities

    @property
    @override
    def address(self) -> str:
        return self._address

    # --------------------------------------------------------------------------------------- the link

    @override
    def open(self, deadline: float) -> None:
        self._io = threading.get_ident()
        self._asked = None
        self._is_enabled = self._may_move = self._is_made_ready = self._is_left = False
        self._rate.begin()
        self._hand.open(deadline, lambda: self._closing)
        self._look()

    @override
    def will_close(self) -> None:
        self._closing = True

    @override
    def close(self) -> None:
        policy = self._on_close if self._closing else "hold"
        is_let_go = False
        try:
            if self._hand.is_open and self._may_move and policy == "release":
                is_let_go = self._let_go()
        except DeviceError as error:
            log.warning("%s was not opened: %s", self.address, error)
        finally:
            was_used = self._is_enabled or self._is_left
            should_rest = self._is_made_ready or (
                was_used and not is_let_go and policy != "nothing" and not self.is_taken_over
            )
            self._is_enabled = self._may_move = self._is_made_ready = self._is_left = False
            self._hand.close(moves=should_rest and not self._is_stopped)

    def _let_go(self) -> bool:
        """Do the last act of a program that ends in good order; return whether it may be done."""
        deadline = time.monotonic() + FAREWELL
        self._see_whose(deadline)
        if self._hand.is_in_doubt or self.condition.allows is not OperatingState.ENABLED:
            return False
        self._hand.let_go()
        while not self._hand.is_told and time.monotonic() < deadline:
            self._hand.exchange(time.monotonic() + PIECE)
        if not self._hand.is_told:
            log.warning("%s was not opened: it took no order in %g s", self.address, FAREWELL)
        return self._hand.is_told

    def _see_whose(self, deadline: float) -> None:
        """Read until it is known whether another program has just taken it."""
        is_read = False
        while (self._hand.is_in_doubt or not is_read) and time.monotonic() < deadline:
            is_read |= self._hand.exchange(time.monotonic() + PIECE) is not None

    @override
    def read(self, deadline: float) -> Sample | None:
        self._io = threading.get_ident()
        measured = self._hand.exchange(deadline)
        self._look()
        if measured is None:
            return None
        stamp, position, velocity, effort, is_setpoint = measured
        if position is None:
            return Sample(stamp, {})
        if velocity is None:
            velocity = self._rate.at(stamp.monotonic, position, rests=self.has_arrived)
        names = self.capabilities.joints
        efforts = vector([] if effort is None else [effort])
        state = JointState(vector([position]), vector([velocity]), efforts, name=names)
        if is_setpoint:
            return Sample(
                stamp,
                {"measured_js": state, "setpoint_js": JointState(state.position, name=names)},
            )
        return Sample(stamp, {"measured_js": state})

    def _look(self) -> None:
        """See whether it may hold something, and whether it may be moved any longer."""
        doing = self._hand.doing
        if doing in HELD:
            self._may_hold = True
        elif doing in EMPTY:
            self._may_hold = False
        if self._may_move and self.condition.allows is not OperatingState.ENABLED:
            self._may_move, self._asked = False, None
        if self._is_left and self._is_stopped:
            self._is_left = self._is_made_ready = False

    # ---------------------------------------------------------------------------------- what moves it

    @override
    def write(self, setpoint: Setpoint) -> None:
        value = float(setpoint.values[0])
        if setpoint.mode is Mode.JOINT_EFFORT and not value:
            self.stop()
            return
        order = self._hand.order(setpoint.mode, value, 1.0)
        if order != self._asked or self._hand.disobeys:  # else what it does goes on, and is told
            self._asked = order
            self._hand.go(order, at_once=False)

    @override
    def move(self, goal: Goal) -> None:
        assert goal.joints is not None
        value = float(goal.joints[0])
        self._hand.check("move_jp", value)
        self._asked = self._hand.order(Mode.JOINT_POSITION, value, goal.ratios.velocity)
        self._hand.go(self._asked, at_once=True)

    @override
    def move_progress(self) -> MoveProgress:
        if refusal := self._hand.refusal:
            raise MotionAborted(
                f"the gripper does not carry it out: {refusal}",
                remedy="Does another program, or its own page, command it?",
            )
        if self._hand.taken_over or self._asked is None:
            return MoveProgress.FAILED
        if not self.has_arrived:
            return MoveProgress.RUNNING
        return MoveProgress.DONE if self._hand.has_reached else MoveProgress.FAILED

    @property
    @override
    def has_arrived(self) -> bool:
        return self._is_stopped and self._hand.doing not in ON_ITS_WAY

    @override
    def stop(self) -> None:
        goes_on = self._closing and self._on_close == "nothing" and not self._is_made_ready
        if goes_on or not self._hand.is_open or self.is_taken_over:
            return
        aside = threading.get_ident() != self._io
        if self._closing and self._hand.is_in_doubt and not (aside or self._is_made_ready):
            return  # it is known soon whose motion that is, and the core asks again until it stands
        self._asked = None
        self._hand.halt(aside=aside)

    @property
    @override
    def has_stopped(self) -> bool:
        return self._is_stopped

    @property
    def _is_stopped(self) -> bool:
        return self._hand.is_told and self._hand.rests

    # --------------------------------------------------------------------------------------- its state

    @property
    @override
    def found(self) -> str:
        doing, unfit = self._hand.doing, self._hand.unfit(enabled=False)
        if self._hand.is_open and unfit is not None:
            return unfit.reason
        is_live = doing in HELD or doing in ON_ITS_WAY - {Doing.UNKNOWN}
        return f"it {_FOUND.get(doing, doing)}" if is_live else ""

    @property
    @override
    def condition(self) -> Condition:
        hand = self._hand
        if not hand.is_open:
            return Condition()
        fault = hand.fault
        if fault is not None and fault.weight in (Weight.STOPS, Weight.RESET):
            return Condition(OperatingState.FAULT, with_remedy(fault.text, fault.remedy))
        unfit = hand.unfit(enabled=self._is_enabled)
        if unfit is not None:
            return unfit
        if hand.taken_over:
            return Condition(OperatingState.PAUSED, "another program commands it")
        return Condition()

    @property
    @override
    def is_taken_over(self) -> bool:
        return self._hand.is_open and self._hand.is_others and not self._is_made_ready

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        hand = self._hand
        if not hand.is_open:
            return ()
        fault = hand.fault
        if fault is not None and fault.weight is Weight.STOPS:
            return (DeviceFault(fault.text, where=hand.where, remedy=fault.remedy),)
        return hand.obstacles(may_hold=self._may_hold)

    @override
    def enable(self) -> Steps:
        raise_first(self.obstacles)
        hand = self._hand
        self._is_made_ready = True
        yield from hand.make_ready(may_hold=self._may_hold)
        self._is_made_ready = False
        yield from self.resume()

    @override
    def resume(self) -> Steps:
        """Take up what it does; one that is not ready any more is not PAUSED, and is enabled anew."""
        hand = self._hand
        hand.adopt()
        yield  # what it does is judged anew
        if not self._is_stopped:  # it goes where somebody else has sent it
            self.stop()
            if not (yield from until(lambda: self._is_stopped, STANDS)):
                raise TransitionFailed(
                    f"it does not come to rest in {STANDS:g} s",
                    where=hand.where,
                    remedy="Does another program command it?",
                )
            if (unfit := hand.unfit(enabled=True)) is not None:  # the stop has broken something off
                raise TransitionFailed(unfit.reason, where=hand.where, remedy="Enable it again.")
        yield from hand.sort_out()
        hand.adopt()
        self._asked = None
        self._is_enabled = self._may_move = True

    @override
    def left(self) -> None:
        self._may_move = self._is_enabled = False
        self._is_left = True  # until it is seen to stand

    @override
    def disable(self) -> Steps:
        self._is_enabled = self._may_move = False
        if not self._is_stopped:  # a service has begun since the stop before this was read back
            self.stop()
        yield from ()

    pause = disable

    # ------------------------------------------------------------------------------------ beyond CRTK

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        return {
            name: Service(
                service.summary,
                partial(self._served, name, service),
                service.moves,
                service.stops,
            )
            for name, service in self._hand.services.items()
        }

    def _served(self, name: str, service: HandService) -> Answer:
        if service.when is not When.ANY and self._may_move is not (service.when is When.ENABLED):
            remedy = "Enable it." if service.when is When.ENABLED else "Disable it first."
            raise self._refused(name, service.when.value, remedy)
        if service.empty and self._hand.doing in HELD:
            raise self._refused(name, "it holds something", "Take it out first, or use release.")
        if service.when is When.ENABLED:
            self._asked = None
            return (yield from self._while_enabled(name, service))
        if service.when is When.NOT_ENABLED:
            return (yield from self._while_not_enabled(service))
        return (yield from service.run())

    def _while_not_enabled(self, service: HandService) -> Answer:
        """Do it; what it has begun goes on where it is broken off, until the stop that follows is seen."""
        self._is_made_ready, has_ended = service.moves, False
        try:
            answer = yield from service.run()
            has_ended = True
        finally:
            self._is_left = not has_ended
        self._is_made_ready = self._may_hold = False  # that has dropped what it held
        return answer

    def _while_enabled(self, name: str, service: HandService) -> Answer:
        """Do it as long as the gripper may be moved: what is left of it then is not done."""
        steps = service.run()
        try:
            while True:
                try:
                    next(steps)
                except StopIteration as end:
                    return str(end.value)
                yield
                if not self._may_move:
                    raise self._refused(name, "it is not enabled any more", "Enable it.")
        finally:
            steps.close()

    def _refused(self, name: str, text: str, remedy: str) -> CommandRefused:
        where = self._hand.where
        return CommandRefused(name, Reason.INVALID_TRANSITION, text, where=where, remedy=remedy)

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        where = self._hand.where
        return {number.name: number.input(where) for number in self._hand.adjustables}

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        common = {
            "holds": Reading("whether it holds something", Payload.FLAG, self._tell_holds),
            "grip": Reading("what it does", Payload.TEXT, self._tell_doing),
            "fault": Reading("what it reports; empty: nothing", Payload.TEXT, self._tell_fault),
        }
        return {**(common if self.capabilities.joints else {}), **self._hand.readings}

    def _tell_holds(self) -> Value | None:
        doing = self._hand.doing
        is_unknown = doing is Doing.UNKNOWN or (doing in _TELLS_NOTHING and self._may_hold)
        return None if is_unknown or not self._hand.is_open else Flag(doing in HELD)

    def _tell_doing(self) -> Value | None:
        return Text(self._hand.doing) if self._hand.is_open else None

    def _tell_fault(self) -> Value | None:
        if not self._hand.is_open:
            return None
        fault = self._hand.fault
        return Text("" if fault is None else with_remedy(fault.text, fault.remedy))

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        doing, fault = self._hand.doing, self._hand.fault
        found = [Note(Severity.WARNING, "object", _TOLD[doing])] if doing in _TOLD else []
        if fault is not None and fault.weight is Weight.PASSES:
            found.append(Note(Severity.WARNING, "fault", fault.text))
        return (*found, *self._hand.notes)

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return self._hand.counters


_TELLS_NOTHING: Final = frozenset({Doing.INACTIVE, Doing.ERROR, Doing.STOPPED})
"""In which what was held may be held still."""
_FOUND: Final[Mapping[Doing, str]] = {
    Doing.MOVING: "moves",
    Doing.PRESSING: "closes on an object",
}
_TOLD: Final[Mapping[Doing, str]] = {
    Doing.LOST: "what it held is gone",
    Doing.WRONG: "what it holds is of another size",
}
