"""A SCHUNK gripper by its process image: one joint, the opening between its fingers."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Final

from typing_extensions import override

from crtk_driver_schunk.gripper.config import SchunkConfig
from crtk_driver_schunk.gripper.connecting import ask, asked_of, make_link
from crtk_driver_schunk.gripper.faults import FAST_STOP, WARNINGS, fault_of
from crtk_driver_schunk.gripper.grip import Grip
from crtk_driver_schunk.gripper.handshake import GIVEN_UP, Handshake
from crtk_driver_schunk.gripper.image import CONTROL, SIZE, STATUS, Command, Control, State, Status
from crtk_driver_schunk.gripper.link import Question
from crtk_driver_schunk.gripper.parameters import Described
from crtk_drivers.device import (
    Answer,
    Capabilities,
    Condition,
    JointLimits,
    Mode,
    Note,
    Severity,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import (
    CommandRefused,
    DeviceError,
    ProtocolError,
    Reason,
    TransitionFailed,
)
from crtk_drivers.kit import until
from crtk_drivers.kit.gripping import (
    HELD,
    Adjustable,
    Doing,
    Fault,
    GripperDevice,
    Hand,
    HandService,
    Measured,
    Weight,
    When,
)
from crtk_drivers.state import OperatingState

__all__ = ["SchunkHand", "create"]

SETTLING: Final = 0.05
"""Time constant of the velocity in s."""
CLOSED: Final = 0.5e-3
"""Metres above the closed end that count as it."""
TURN: Final = 2.0
"""Seconds in which a command must show."""
ACKNOWLEDGED: Final = 0.5
"""Seconds in which an error must be gone after it was acknowledged."""
SERVED: Final = 15.0
"""Seconds that a brake test or a start may take."""

_STOP: Final = Command(Control.RUN | Control.STOP)
_ACKNOWLEDGE: Final = Command(Control.RUN | Control.ACKNOWLEDGE)
_RELEASE: Final = Command(Control.RUN | Control.RELEASE)


def create(config: SchunkConfig) -> GripperDevice:
    """Return the device; nothing is opened."""
    return GripperDevice(SchunkHand(config), config.place, config.on_close, SETTLING)


class SchunkHand(Hand):
    """One gripper."""

    def __init__(self, config: SchunkConfig) -> None:
        self._config = config
        self._given_up: Callable[[], bool] = lambda: False
        self._link = make_link(config, lambda: self._given_up() and self._status is None)
        self._handshake = Handshake()
        self._grip = Grip()
        self._described: Described | None = None
        self._status: Status | None = None
        text = "force in N of the next grips at the closed end"
        force = config.force or 0.5 * config.max_force
        self._force = Adjustable(
            "force", text, force, lambda: (0.0, config.max_force), "N", above=True
        )
        self._strangers = 0
        limits = JointLimits(
            lower=config.lower,
            upper=config.upper,
            velocity=config.speed,
            acceleration=200.0 * config.speed,
            jerk=10_000.0 * config.speed,
            effort=config.max_force,
        )
        self.capabilities = Capabilities(
            joints=(config.joint,),
            joint_units=("m",),
            limits=(limits,),
            modes=frozenset({Mode.JOINT_POSITION, Mode.JOINT_EFFORT}),
            estimates=frozenset({Mode.JOINT_EFFORT}),
            native_moves=frozenset({"move_jp"}),
            rate=config.rate,
            transition_timeout=2.0 * SERVED,
            stop=StopPolicy(
                60.0,
                "goes on to where it was sent last, which is one setpoint or one move away; keeps its grip",
            ),
            velocity_resolution=(1e-4,),
        )

    @property
    @override
    def where(self) -> str:
        return self._link.where

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        shaken = self._handshake
        return {
            **self._link.counters,
            "commands_repeated": shaken.repeated,
            "commands_of_others": shaken.by_others,
        }

    # ------------------------------------------------------------------------------------- the link

    @property
    @override
    def is_open(self) -> bool:
        return self._status is not None

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self._given_up = given_up
        self._status = None
        self._handshake.begin()
        self._grip.begin()
        self._link.open(deadline)
        try:
            self._described = asked_of(self._link, self._config, deadline)
            self._take(ask(self._link, Question(STATUS, SIZE), deadline), time.monotonic())
        except DeviceError:
            self._link.close()
            raise

    @override
    def close(self, *, moves: bool) -> None:
        self._status = None
        self._link.close()

    @override
    def exchange(self, deadline: float) -> Measured | None:
        while True:
            command = self._handshake.to_write()
            question = Question(STATUS, SIZE) if command is None else self._written(command)
            reply = self._link.exchange(question, deadline)
            if reply is None:
                return None
            if command is not None:
                self._handshake.written(time.monotonic())
                continue
            status = self._take(reply.data, reply.asked.monotonic)  # it may be read late
            if not self._handshake.is_midway:
                return Measured(reply.asked, status.position)

    def _written(self, command: Command) -> Question:
        assert self._described is not None
        return Question(CONTROL, SIZE, command.image(self._described.order))

    def _take(self, image: bytes, now: float) -> Status:
        assert self._described is not None
        try:
            status = Status.parse(image, self._described.order)
        except ValueError as error:
            raise ProtocolError(
                str(error), where=self._link.where, remedy="Is it a SCHUNK EGU, EGK or EZU?"
            ) from error
        taken = self._handshake.seen(status, now)
        if taken is not None:
            self._grip.taken(taken, now)
        self._status = status
        self._grip.see(status, now, stops=self._handshake.pending is _STOP)
        return status

    # ---------------------------------------------------------------------------------- what moves it

    @override
    def order(self, mode: Mode, value: float, ratio: float) -> Command:
        if mode is Mode.JOINT_EFFORT:
            return self._gripping(value)
        return self._to(value, ratio * self._config.speed)

    def _to(self, opening: float, speed: float) -> Command:
        if self._config.grip_at_end and opening < self._config.lower + CLOSED:
            return self._gripping(-self._force.value)
        return Command(Control.RUN | Control.MOVE, position=opening, speed=speed)

    def _gripping(self, force: float) -> Command:
        """Return the command that grips, inwards if the force is negative."""
        assert self._described is not None
        bits = Control.RUN | Control.GRIP
        if force > 0.0:
            bits |= Control.OUTWARD
        if self._config.keep_unpowered and self._described.has_brake:
            bits |= Control.KEEP
        percent = round(100.0 * abs(force) / self._described.max_force)
        return Command(bits, force=min(max(percent, 1), 100))

    @override
    def go(self, order: Command, *, at_once: bool) -> None:
        self._handshake.ask(order)

    @override
    def halt(self, *, aside: bool) -> None:
        shaken = self._handshake
        if shaken.pending is not _STOP:
            if self.rests and (shaken.pending is None if aside else shaken.withdraw()):
                return  # a grip is kept
            shaken.ask(_STOP)
        if aside:
            shaken.has_shouted = True
            self._link.shout(self._written(_STOP))

    @override
    def let_go(self) -> None:
        if self.doing in HELD:
            self._handshake.ask(_RELEASE)

    @property
    @override
    def is_told(self) -> bool:
        return self._handshake.pending is None

    @property
    @override
    def doing(self) -> Doing:
        return self._grip.doing

    @property
    @override
    def rests(self) -> bool:
        return not self._grip.runs_on and super().rests

    # --------------------------------------------------------------------------------------- its state

    @property
    @override
    def fault(self) -> Fault | None:
        status = self._status
        if status is not None and State.ERROR in status.bits:
            return fault_of(status.error)
        if self._handshake.attempts >= GIVEN_UP:
            remedy = "Does another master, or its web page, command it?"
            return Fault("it takes no commands", remedy, Weight.RESET)
        return None

    @property
    @override
    def taken_over(self) -> bool:
        return self._handshake.by_others != self._strangers

    @override
    def unfit(self, *, enabled: bool) -> Condition | None:
        bits = self._status.bits if self._status else State.READY
        for bit, text in _NOT_USABLE.items():
            if bit in bits:
                return Condition(OperatingState.DISABLED, text)
        if State.READY not in bits:
            return Condition(OperatingState.DISABLED, "it is not ready")
        return None

    @override
    def adopt(self) -> None:
        self._strangers = self._handshake.by_others

    @override
    def make_ready(self, *, may_hold: bool) -> Steps:
        status = self._status
        assert status is not None
        self._handshake.attempts = 0
        if State.ERROR in status.bits or State.READY not in status.bits:
            yield from self._carried_out(
                _ACKNOWLEDGE, lambda now: State.ERROR not in now.bits, ACKNOWLEDGED
            )

    def _carried_out(
        self, command: Command, test: Callable[[Status], bool], timeout: float
    ) -> Steps:
        """Have a command carried out, outside of motion."""
        self._handshake.ask(command)
        what = f"it did not {_CALLED[command.bits]}"
        try:
            yield from self._shown(test, timeout, what)
        finally:
            self._handshake.withdraw()

    def _shown(self, test: Callable[[Status], bool], timeout: float, what: str) -> Steps:
        def shows() -> bool:
            status = self._status
            return self._handshake.pending is None and status is not None and test(status)

        if (yield from until(shows, timeout)):
            return
        fault = self.fault
        text = f"{what} in {timeout:g} s" if fault is None else f"{what}: {fault.text}"
        remedy = fault.remedy if fault else "Is it free to move? Does another master command it?"
        raise TransitionFailed(text, where=self._link.where, remedy=remedy)

    # ------------------------------------------------------------------------------------ beyond CRTK

    @property
    @override
    def services(self) -> Mapping[str, HandService]:
        return {
            "fast_stop": HandService(
                "stop it as fast as it can, in any state; enable acknowledges that",
                self._fast_stop,
                When.ANY,
                moves=False,
                stops=True,
            ),
            "release": HandService("let go of what it holds, by its own distance", self._released),
            "brake_test": HandService(
                "test its brake, with nothing held", self._brake_test, empty=True
            ),
            "soft_reset": HandService(
                "start its electronics anew, with nothing held",
                self._soft_reset,
                When.NOT_ENABLED,
                empty=True,
                moves=False,
            ),
        }

    def _fast_stop(self) -> Answer:
        command = Command(Control(0))
        yield from self._carried_out(command, lambda now: now.error == FAST_STOP, TURN)
        return "stopped; enable acknowledges it"

    def _released(self) -> Answer:
        yield from self._carried_out(_RELEASE, lambda _: self.rests, TURN)
        return str(self.doing)

    def _brake_test(self) -> Answer:
        described = self._described
        if described is None or not described.has_brake:
            model = described.model if described else "it"
            raise CommandRefused(
                "brake_test", Reason.UNSUPPORTED, f"{model} has no brake", where=self.where
            )
        command = Command(Control.RUN | Control.BRAKE_TEST)
        yield from self._carried_out(command, lambda now: State.SUCCESS in now.bits, SERVED)
        return "its brake holds"

    def _soft_reset(self) -> Answer:
        self._handshake.ask(Command(Control.RUN | Control.SOFT_RESET))
        yield from until(lambda: self._handshake.pending is None, TURN)
        self._handshake.begin()  # the toggle begins anew as well
        return "it starts anew; enable it when it is back"

    @property
    @override
    def adjustables(self) -> tuple[Adjustable, ...]:
        return (self._force,)

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        found: list[Note] = []
        if self._described is not None:
            told = self._described
            text = f"{told.model}, {told.fieldbus}, serial {told.serial}, firmware {told.firmware}"
            found.append(Note(Severity.INFO, "gripper", text))
        status = self._status
        if status is not None and State.WARNING in status.bits:
            text = WARNINGS.get(status.warning, "a warning that is in no table")
            found.append(Note(Severity.WARNING, "warning", f"{text} ({status.warning:02X})"))
        return tuple(found)


_NOT_USABLE: Final[Mapping[State, str]] = {
    State.SHUTDOWN: "it is prepared for shutdown: use the service soft_reset, or its power",
    State.MANUAL: "it is released for movement by hand: end that at its web page",
}
_CALLED: Final[Mapping[Control, str]] = {
    Control(0): "stop",
    _ACKNOWLEDGE.bits: "take the acknowledgement",
    _RELEASE.bits: "let go",
    Control.RUN | Control.BRAKE_TEST: "finish the brake test",
}
