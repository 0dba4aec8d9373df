"""An arm of a da Vinci Research Kit that is driven: efforts of its joints become currents of its motors.

There is no position loop, here or in the boards: with zero current nothing holds an arm but what it is built
with. Whatever is wrong ends in zero current, amplifiers off, power off, and that is read back.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

from typing_extensions import override

from crtk_driver_dvrk.arm import States
from crtk_driver_dvrk.asked_registers import AskedRegisters, Place
from crtk_driver_dvrk.boards import Found
from crtk_driver_dvrk.config import DvrkConfig
from crtk_driver_dvrk.device import DvrkDevice
from crtk_driver_dvrk.drive import Drive
from crtk_driver_dvrk.efforts import Efforts
from crtk_driver_dvrk.encoder_setting import preloads
from crtk_driver_dvrk.motor_file import read_motors
from crtk_driver_dvrk.orders import watchdog_counts
from crtk_driver_dvrk.others import OtherReaders
from crtk_driver_dvrk.powering import STEP, Powering
from crtk_driver_dvrk.registers import (
    MIDDLE,
    BoardState,
    Register,
    elapsed_of,
    preload,
    switched_on,
)
from crtk_driver_dvrk.safeguards import HOT, WARM, Lasting, Safeguards, Trouble
from crtk_drivers.device import (
    Answer,
    Condition,
    JointLimits,
    Mode,
    Note,
    Service,
    Setpoint,
    Severity,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import (
    ConnectionLost,
    CrtkError,
    DeviceFault,
    TransitionFailed,
    raise_first,
)
from crtk_drivers.kit.waiting_steps import until
from crtk_drivers.samples import JointState, Sample
from crtk_drivers.state import OperatingState

logger = logging.getLogger(__name__)

_CALM: Final = 5
"""Samples that must be in order with amplifiers on before an arm is ENABLED."""

_TOO_FAST: Final = 1.5
"""Of the fastest that a joint may get; a stream of efforts is ended before."""

_COASTS: Final = 1.0
"""Seconds in which a joint comes to rest without an effort; one that moves for longer falls, or is moved."""

_RESTS: Final = 0.03
"""Of the fastest that a joint may get: slower than that it rests."""

_LAST: Final = 0.3
"""Seconds for which boards that are left are told to switch off, at most."""

_UNHELD: Final = (
    "nothing holds the arm while its amplifiers are off or no efforts come: what has weight falls"
)


class DrivenDevice(DvrkDevice):
    """An arm.

    Args:
        config: where it is, dVRK's files of it, and how it may be driven.

    Raises:
        ConfigError: a file cannot be used for driving, or names do not fit it.
    """

    def __init__(self, config: DvrkConfig) -> None:
        super().__init__(config)
        self._motors = motors = read_motors(config.io, config.robot)
        self._watchdog = watchdog_counts(config.watchdog)
        self._efforts = Efforts(motors, self._arm.coupling, config.current_share)
        self._drive = Drive(self._boards, motors, self._efforts.zero)
        self._powering = Powering(
            self._drive, lambda: self._states, self._sampled, self._boards.where
        )
        self._registers = AskedRegisters(self._boards)
        self._safeguards = Safeguards(self._joints, motors, config.current_error)
        self._others = {board: OtherReaders() for board in self._arm.boards}
        self._unasked = Lasting()
        self._tripped: Trouble | None = None
        self._is_found = self._running = ""
        self._capabilities = replace(
            self._capabilities,
            limits=self._limits(),
            modes=frozenset({Mode.JOINT_EFFORT}),
            writes_every_cycle=True,
            enable_moves=True,
            stop=StopPolicy(config.watchdog, f"zero current; {_UNHELD}", _COASTS),
        )

    def _limits(self) -> tuple[JointLimits, ...]:
        config = self._config
        fastest = (config.linear_velocity if motor.is_linear else config.angular_velocity
                   for motor in self._motors)  # fmt: skip
        alike = self._capabilities.limits
        return tuple(
            replace(limits, velocity=speed, effort=effort)
            for limits, speed, effort in zip(
                alike, fastest, self._efforts.most.tolist(), strict=True
            )
        )

    # ------------------------------------------------------------------------------------ open, close

    @override
    def open(self, deadline: float) -> None:
        super().open(deadline)
        nodes = {board.board: board.node for board in self._found}
        self._registers.reached(nodes)
        self._others = {board: OtherReaders() for board in nodes}
        self._tripped = None
        on = (switched_on(self._once(board, Register.STATUS, deadline)) for board in self._found)
        self._is_found = " and ".join(dict.fromkeys(filter(None, on)))

    @override
    def _reached(self, found: list[Found]) -> None:
        """Switch off what this driver has left on, also where a board of the arm is missing."""
        self._drive.reached({each.board: each.node for each in found if each.board in self._used})
        self._drive.off()

    @property
    @override
    def found(self) -> str:
        return self._is_found

    @override
    def close(self) -> None:
        """Switch off what is on, and read that back for 0.3 s; watchdogs are left to do what is not."""
        try:
            self._drive.off()
            if self._boards.is_open and not self._drive.is_free:
                self._finish()
        finally:
            self._registers.keep({})
            super().close()

    def _finish(self) -> None:
        deadline = time.monotonic() + _LAST
        why = "no answer"
        while not self._drive.is_free and time.monotonic() < deadline:
            try:
                self._drive.cycle()
                if super().read(min(deadline, time.monotonic() + self._config.reply_timeout)):
                    self._drive.take(self._states, self._before)
            except ConnectionLost as error:
                why = error.statement
                break
        if not self._drive.is_free:
            logger.warning(
                "%s: that amplifiers and power are off could not be read back (%s): watchdogs switch "
                "amplifiers off within %g s",
                self._boards.where,
                why,
                self._config.watchdog,
            )

    # ------------------------------------------------------------------------------------------ cycle

    @override
    def read(self, deadline: float) -> Sample | None:
        self._registers.collect()
        self._drive.cycle()
        sample = super().read(deadline)
        if sample is not None:
            self._drive.take(self._states, self._before)
            self._judge(sample)
            self._registers.ask()
        elif self._drive.is_on:
            age = time.monotonic() - self._before
            if age > self._config.feedback_timeout:
                self._trip(
                    Trouble(
                        f"boards have not told their state for {age:.3f} s",
                        "Look at the boards' network and at the load of this computer; then send enable.",
                    )
                )
        return sample

    def _judge(self, sample: Sample) -> None:
        """Look whether the arm may be driven on."""
        if not self._drive.is_on:
            return
        states, asked = self._states, self._before
        trouble = (
            self._safeguards.trouble(states, asked)
            or self._drive.trouble(states, asked)
            or self._registers.trouble
            or self._other_reader(asked)
            or self._moves(sample, asked)
        )
        if trouble is not None:
            self._trip(trouble)

    def _moves(self, sample: Sample, asked: float) -> Trouble | None:
        """Return what moves faster than any may, or for long though no effort is asked for."""
        state = sample.values["measured_js"]
        assert isinstance(state, JointState)
        rows = zip(self._names, state.velocity.tolist(), self._capabilities.limits, strict=True)
        for name, speed, limits in rows:
            if abs(speed) > _TOO_FAST * limits.velocity:
                words = f"faster than {limits.velocity:g}"
            elif self._unasked.lasts(
                name,
                _COASTS,
                asked,
                is_so=self._drive.is_idle and abs(speed) > _RESTS * limits.velocity,
            ):
                words = "without any effort"
            else:
                continue
            return Trouble(
                f"{name} moves at {speed:.3f}, {words}: does it fall?",
                "Hold the arm, and send enable; what holds it by efforts must send them all the time.",
            )
        return None

    def _other_reader(self, now: float) -> Trouble | None:
        for board, readers in self._others.items():
            if readers.are_there(now):
                return Trouble(
                    f"another program reads the state of board {board}",
                    "Two programs must not have one controller: end it (dVRK's own?), then send enable.",
                )
        return None

    def _trip(self, trouble: Trouble) -> None:
        """Switch off; the reason is told until the next `enable` or `disable`."""
        self._tripped = self._tripped or trouble
        self._drive.off()

    @override
    def _ask(self, board: Found) -> None:
        self._others[board.board].asked(time.monotonic())
        super()._ask(board)

    @override
    def _believed(self, board: Found, quadlets: tuple[int, ...], now: float) -> BoardState | None:
        if quadlets:
            self._others[board.board].answered(elapsed_of(quadlets[0]), now)
        return super()._believed(board, quadlets, now)

    @property
    @override
    def condition(self) -> Condition:
        if self._tripped is not None:
            return Condition(OperatingState.FAULT, str(self._tripped))
        condition = super().condition
        if condition.reason:
            reason = f"{condition.reason}. Look at its cable, and home the arm; then send enable."
            return Condition(condition.allows, reason)
        return condition

    # ------------------------------------------------------------------------------------------ motion

    @override
    def write(self, setpoint: Setpoint) -> None:
        try:
            bits = self._efforts.bits(setpoint.values)
        except ValueError as error:
            self._drive.off()
            raise DeviceFault(str(error), where=self._boards.where) from error
        self._drive.currents(bits)

    @override
    def stop(self) -> None:
        self._drive.zero()

    @override
    def left(self) -> None:
        self._drive.off()

    @property
    @override
    def has_stopped(self) -> bool:
        return self._drive.has_stopped

    # -------------------------------------------------------------------------------------- procedures

    @override
    def enable(self) -> Steps:
        """Switch on, each step read back; one that fails, or is broken off, leaves nothing on."""
        self._tripped = None
        relays: list[int] = []
        is_on = False
        try:
            with self._alone("enable"):
                yield from self._sampled(1)
                yield from self._arm_boards()
                relays = [board.board for board in self._states.values() if not board.relay]
                yield from self._power_up()
            is_on = True
        finally:
            if not is_on:
                self._registers.keep({})
                self._drive.off(relays)

    @contextmanager
    def _alone(self, name: str) -> Iterator[None]:
        """Carry out what must not go on beside another one of its kind."""
        if self._running:
            raise TransitionFailed(
                f"{self._running} is being carried out", where=self._boards.where
            )
        self._running = name
        try:
            yield
        finally:
            self._running = ""

    def _arm_boards(self) -> Steps:
        """Refuse boards that are not in order; set their watchdogs."""
        if not (yield from until(lambda: self._drive.is_free, STEP)):
            raise TransitionFailed(
                "amplifiers and power that this driver had on cannot be read back as off",
                where=self._boards.where,
                remedy="Does another program drive the arm? Take its power away by the emergency stop.",
            )
        raise_first(self._of_boards())
        kept: dict[Place, int] = {}
        for board, axes in self._used.items():
            watchdog = board, int(Register.WATCHDOG)
            yield from self._registers.write(watchdog, self._watchdog)
            kept[watchdog] = self._watchdog
            for axis in axes:
                place = board, preload(axis)
                kept[place] = yield from self._registers.read(place)
        self._unset = tuple(
            dict.fromkeys(
                place[0] for place, value in kept.items() if value == MIDDLE and place[1] > 15
            )
        )
        raise_first(self._of_encoders())
        self._registers.keep(kept)

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        if self._drive.is_on:
            return ()
        return (*self._of_boards(), *self._of_encoders())

    def _of_boards(self) -> Iterator[TransitionFailed]:
        """Yield why boards are not in order."""

        def failed(text: str, remedy: str) -> TransitionFailed:
            return TransitionFailed(text, where=self._boards.where, remedy=remedy)

        if self._trouble:
            yield failed(self._trouble, "Look at the encoders and their cables.")
        for number, state in self._states.items():
            on = [axis for axis in self._used[number] if not state.axes[axis].is_off]
            if on:
                yield failed(
                    f"board {number}: amplifiers of axes {', '.join(map(str, on))} are on, and not by this "
                    "driver",
                    "Another program drives the arm: end it (dVRK's own?) first.",
                )
            if max(state.temperatures) > HOT:
                yield failed(
                    f"board {number} is hotter than {HOT:g} °C", "Let the controller cool down."
                )
        other = self._other_reader(self._before)
        if other is not None:
            yield failed(other.words, other.remedy)

    def _of_encoders(self) -> Iterator[TransitionFailed]:
        """Yield which encoders have not been set, as it was read last."""
        if self._unset:
            yield TransitionFailed(
                f"encoders of board {', '.join(map(str, self._unset))} have not been set since it was "
                "switched on: nobody knows where the arm is",
                where=self._boards.where,
                remedy="Home the arm with dVRK's program, or use the service set_encoders.",
            )

    def _power_up(self) -> Steps:
        yield from self._powering.up(self._motors)
        self._safeguards.begin()
        self._unasked.clear()
        self._drive.on()
        yield from self._sampled(_CALM)
        if self._tripped is not None:
            trouble = self._tripped
            raise DeviceFault(trouble.words, where=self._boards.where, remedy=trouble.remedy)

    def _sampled(self, count: int) -> Steps:
        """Wait for some readings of all boards that are asked for from now on."""
        goal, since = self._counted["readings"] + count, time.monotonic()
        if not (
            yield from until(
                lambda: self._counted["readings"] >= goal and self._before >= since, STEP
            )
        ):
            raise DeviceFault(
                "boards do not tell their state",
                where=self._boards.where,
                remedy="Look at the network of the boards.",
            )

    @override
    def disable(self) -> Steps:
        """Switch off, also what was found on: an earlier driver that was killed leaves its power on."""
        self._tripped = None
        self._registers.keep({})
        self._drive.off()
        if not self._states:
            yield from self._sampled(1)
        self._drive.off_found(self._states)
        if not (yield from until(lambda: self._drive.is_free, STEP)):
            raise DeviceFault(
                f"amplifiers and power are not read back as off within {STEP:g} s",
                where=self._boards.where,
                remedy="Take the power away by the emergency stop, then look at the network of the boards.",
            )

    @override
    def pause(self) -> Steps:
        """As `disable`: without efforts there is nothing that power is kept for."""
        yield from self.disable()

    # ------------------------------------------------------------------------------------ what it tells

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        if not self._arm.has_potentiometers:
            return {}
        summary = "set encoders by potentiometers, as dVRK's homing does; while power is off"
        return {"set_encoders": Service(summary, self._set_encoders)}

    def _set_encoders(self) -> Answer:
        where = self._boards.where
        with self._alone("set_encoders"):
            yield from self._sampled(1)
            values = yield from preloads(self._joints, self._unpowered, where)
            for motor, value in zip(self._motors, values, strict=True):
                self._unpowered()
                yield from self._registers.write((motor.board, preload(motor.axis)), value)
        self._about = [note for note in self._about if note.key != "encoders"]
        self._unset = ()
        return f"encoders of {len(values)} axes are set by their potentiometers"

    def _unpowered(self) -> States:
        """Return the states of boards, none of which has power for its motors.

        Raises:
            TransitionFailed: one has.
        """
        on = [str(board.board) for board in self._states.values() if board.power]
        if on or not self._drive.is_free:
            what = f"motors of board {', '.join(on)} have power" if on else "amplifiers may be on"
            raise TransitionFailed(
                what,
                where=self._boards.where,
                remedy="Send disable first; if another program drives the arm, end it.",
            )
        return self._states

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        warm = (
            Note(
                Severity.WARNING,
                f"board {state.board} temperature",
                f"{max(state.temperatures):g} °C",
            )
            for state in self._states.values()
            if max(state.temperatures) >= WARM
        )
        return (*super().notes, Note(Severity.WARNING, "without power", _UNHELD), *warm)

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        drive = self._drive
        return {
            **super().counters,
            "late writes": drive.late_writes,
            "late switches": drive.late_switches,
            "foreign currents": drive.foreign_currents,
        }
