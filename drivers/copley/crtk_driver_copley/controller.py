"""The drives at one serial line, as the kit's device of axes wants them."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Final

from typing_extensions import override

from crtk_driver_copley.axis import Axis
from crtk_driver_copley.codec import Reply, get, put
from crtk_driver_copley.config import CopleyConfig
from crtk_driver_copley.halting import Halting
from crtk_driver_copley.line import Line
from crtk_driver_copley.procedures import Procedures
from crtk_driver_copley.rounds import Rounds
from crtk_driver_copley.stream import delay_of
from crtk_driver_copley.tables import (
    ACCELERATION_UNIT,
    CLEAR_PVT,
    CONDITIONS,
    DISABLED,
    HINDERS,
    PROGRAMMED_POSITION,
    VELOCITY_UNIT,
    Parameter,
    Trajectory,
    error_text,
)
from crtk_driver_copley.tracking import AMPLE, ByProfile, ByPvt, Tracking
from crtk_drivers.device import Capabilities, Note, Severity, Steps
from crtk_drivers.errors import (
    ConnectionFailed,
    ConnectionLost,
    DeviceError,
    TransitionFailed,
)
from crtk_drivers.kit import until
from crtk_drivers.kit.axes import (
    AxesDevice,
    AxisTold,
    Complaint,
    Counted,
    Counting,
    Heard,
    MotionController,
    Words,
    braking_time,
    promises,
)

__all__ = ["CopleyController", "create"]

QUICK: Final = 8.0
"""Acceleration of ramps towards the newest position, in those of the joint: each slows down before it."""
TRANSITION: Final = 10.0
REST: Final = 3.0
"""Seconds in which axes come to rest, or have power, or have none."""
BLIND: Final = 0.2
"""Seconds without a sample after which no setpoint is sent."""
ROUNDS: Final = 3.0
"""Samples of that time at least, where the line carries few."""
FAREWELL: Final = 0.3
"""Seconds in which drives take the power away at the end."""

WORDS: Final = Words(
    Complaint(
        "the axes do not come to rest, although t 0 was taken",
        "Does a program on the drive (CVM) move them? Stop it.",
    ),
    Complaint(
        "the motors are on although the desired state is 0",
        "Take the power away, and look at the drive (CME).",
    ),
)


def create(config: CopleyConfig) -> AxesDevice:
    """Return an arm of axes of drives at one line."""
    return AxesDevice(CopleyController(config), config.port, config.on_close)


class CopleyController(MotionController):
    """Axes of drives at one line.

    Args:
        config: its port and joints.
    """

    words = WORDS
    patience = REST

    def __init__(self, config: CopleyConfig) -> None:
        self._config = config
        joints = config.joints
        self._axes = [Axis(name, joint) for name, joint in joints.items()]
        self._line = Line(config)
        self._tracking = _tracking(config, self._line, self._axes)
        self._procedures = Procedures(self._line, self._axes)
        self._halting = Halting(self._line, self._axes)
        self._rounds = Rounds(
            self._line, self._axes, self._tracking, self._halting, 1.0 / config.rate
        )
        self.homes = [place for place, axis in enumerate(self._axes) if axis.joint.homing]
        self.blind = max(BLIND, ROUNDS / config.carried)
        self.counting = Counting(
            joints,
            [1.0 / joint.counts for joint in joints.values()],
            [joint.torque_per_ampere for joint in joints.values()],
        )
        self.capabilities = _capabilities(config, needs_homing=bool(self.homes))
        self._unhomed = False
        self._firmware = ""
        self._forget()

    def _forget(self) -> None:
        """A connection begins."""
        self._tracking.forget()
        for axis in self._axes:
            axis.forget()
        self.watch(False)
        self._rounds.forget()
        self._halting.forget()
        self._stopped_aside = False
        self._sampled = 0.0  # monotonic s at which what was heard last was asked for

    @property
    @override
    def where(self) -> str:
        return self._line.where

    @property
    @override
    def axes(self) -> Sequence[AxisTold]:
        return [axis.told for axis in self._axes]

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        line = {"echoes": self._line.echoes, "doubted answers": self._line.doubts}
        return {**self._rounds.lost, **line, "restarted streams": self._tracking.restarts}

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        said = "the line repeats commands: is the echo of an adapter or of RS-485 on?"
        firmware = [Note(Severity.INFO, "firmware", self._firmware)] if self._firmware else []
        echo = [Note(Severity.WARNING, "echo", said)] if self._line.echoes else []
        slow = self._tracking.slow
        late = [Note(Severity.WARNING, "slow line", slow)] if slow else []
        return (*firmware, *echo, *late)

    # --------------------------------------------------------------------------------------- the link

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self._forget()
        self._line.open(deadline, given_up)
        try:
            self._firmware = self._told_firmware(deadline)
            for axis in self._axes:
                self._get_to_know(axis, deadline)
        except ConnectionLost as error:
            raise ConnectionFailed(error.message, where=error.where, remedy=error.remedy) from error

    def _told_firmware(self, deadline: float) -> str:
        reply = self._answer(get(self._axes[0].to, Parameter.FIRMWARE), deadline)
        if reply.error or len(reply.values) != 1:
            return ""
        return f"{reply.values[0] >> 8}.{reply.values[0] & 0xFF}"

    def _get_to_know(self, axis: Axis, deadline: float) -> None:
        """Ask what an axis is like now, and refuse one that is not as it should be."""
        asked = [Parameter.STATUS, Parameter.TRAJECTORY, Parameter.POSITION, Parameter.VELOCITY]
        if self._config.tracking == "pvt":
            asked.append(Parameter.PVT)
        for parameter in asked:
            reply = self._answer(get(axis.to, parameter), deadline)
            if reply.error:
                text, remedy = error_text(reply.error)
                raise DeviceError(
                    f"{axis.name}: it does not tell 0x{parameter:02x} ({parameter.name.lower()}): "
                    f"e {reply.error} {text}",
                    where=self.where,
                    remedy=remedy,
                )
            self._rounds.take(axis, parameter, reply)
        if axis.joint.following_error is not None:
            counts = max(1, round(axis.joint.following_error * axis.joint.counts))
            self._answer(put(axis.to, Parameter.FOLLOWING_LIMIT, counts), deadline)
            held = self._answer(get(axis.to, Parameter.FOLLOWING_LIMIT), deadline)
            if held.values != (counts,):
                raise DeviceError(
                    f"{axis.name}: its following error limit (0xba) was set to {counts}, and is told as "
                    f"{held.text!r}",
                    where=self.where,
                    remedy="Leave `following_error` of the joint out, and set the limit of the drive (CME).",
                )

    def _answer(self, command: str, deadline: float) -> Reply:
        """Return the answer to a command; waits for it, as only `open` may."""
        answers: list[Reply | None] = []
        self._line.ask(command, answers.append)
        self._line.pump(deadline)
        if not answers or answers[0] is None:
            raise ConnectionFailed(
                f"no answer to {command!r}",
                where=self.where,
                remedy="Check `node` of each joint, and the CAN bus behind the drive.",
            )
        return answers[0]

    @override
    def close(self, *, power_off: bool) -> None:
        try:
            if power_off:
                for axis in self._axes:
                    self._line.ask(put(axis.to, Parameter.DESIRED_STATE, DISABLED), soon=True)
                self._line.pump(time.monotonic() + FAREWELL)
        except DeviceError:
            pass  # the line is gone, and with it who would be told
        finally:
            self._line.close()

    @override
    def exchange(self, deadline: float) -> Heard:
        if self._stopped_aside:
            self._stopped_aside = False
            self.halt(aside=False)  # with all that a stream had waiting
        # an answer that does not come must not keep the setpoints that are due
        if not self._rounds.go_on(min(deadline, time.monotonic() + 1.0 / self._config.rate)):
            return Heard(None, self._tracking.trouble or self._cannot_follow())
        found, is_sure = self._judged()
        stamp = self._rounds.stamp
        if not (is_sure and self._rounds.is_whole) or stamp is None:
            return Heard(None, found)
        self._sampled = stamp.monotonic
        told = ([a.position, a.velocity, a.current] for a in self._axes)
        positions, rates, efforts = zip(*told, strict=True)
        return Heard(Counted(stamp, positions, rates, efforts), found)

    def _cannot_follow(self) -> str:
        """Return why no setpoint is carried out while a round takes too long; empty if there is no need."""
        is_blind = time.monotonic() - self._sampled > self.blind
        has_streams = any(axis.powered for axis in self._axes)
        homes = any(axis.homing for axis in self._axes)
        return self._tracking.slow if is_blind and has_streams and not homes else ""

    def _judged(self) -> tuple[str, bool]:
        """Return what is a fault, at the end of a round, and whether there is nothing told once only."""
        found: list[str] = []
        all_sure = True
        for axis in self._axes:
            wrong, is_sure = axis.judged()
            found += wrong if is_sure else []
            all_sure &= is_sure
        return " ".join(found) or self._tracking.trouble, all_sure

    @override
    def lost(self) -> None:
        """A drive that is not heard may hear."""
        self._halting.shout()

    # ---------------------------------------------------------------------------------------- motion

    @property
    @override
    def here(self) -> Sequence[float]:
        return [axis.position for axis in self._axes]

    @override
    def admits(self) -> bool:
        return not self._stopped_aside

    @override
    def follow(self, now: float, counts: Sequence[float]) -> None:
        self._tracking.follow(now, counts)

    @property
    @override
    def has_arrived(self) -> bool:
        return self._tracking.has_arrived

    @override
    def halt(self, *, aside: bool) -> None:
        if aside:
            self._stopped_aside = True
            self._halting.aside()
            return
        self._tracking.forget()
        self._procedures.take_back()
        self._halting.begin()

    @property
    @override
    def has_stopped(self) -> bool:
        return self._halting.is_seen

    # ------------------------------------------------------------------------------------------ power

    @override
    def watch(self, on: bool) -> None:
        for axis in self._axes:
            if on:
                axis.judged()  # where it stands is not news
            axis.powered = on

    @property
    @override
    def hindered(self) -> Sequence[Complaint]:
        return [
            Complaint(f"{axis.name}: {CONDITIONS[bit].text}", CONDITIONS[bit].remedy)
            for axis in self._axes
            for bit in HINDERS
            if axis.status & bit
        ]

    @override
    def prepare(self) -> Steps:
        yield from self._procedures.clear_faults()
        yield from self._procedures.do(
            [put(axis.to, *each) for axis in self._axes for each in self._rates(axis)]
        )

    def _rates(self, axis: Axis) -> list[tuple[int, ...]]:
        """Return the parameters that say how fast, and with what acceleration, and their values."""
        joint, by_ramps = axis.joint, self._config.tracking != "pvt"
        braking = max(1, round(joint.acceleration * joint.counts / ACCELERATION_UNIT))
        rates: list[tuple[int, ...]] = [(Parameter.ABORT_DECELERATION, braking)]
        if by_ramps:
            follows = self._config.tracking == "profile"
            speed = (AMPLE if follows else 1.0) * joint.velocity * joint.counts / VELOCITY_UNIT
            ramp = round((QUICK if follows else 1.0) * braking)
            rates += [
                (Parameter.PROFILE_VELOCITY, max(1, round(speed))),
                (Parameter.PROFILE_ACCELERATION, ramp),
                (Parameter.PROFILE_DECELERATION, ramp),
            ]
        else:
            rates.append((Parameter.PVT, CLEAR_PVT))
        return rates

    @override
    def switch(self, on: bool) -> Steps:
        yield from self._procedures.set_state(PROGRAMMED_POSITION if on else DISABLED)

    @override
    def without_power(self) -> Complaint:
        why = [
            f"{axis.name}: {meaning.text}. {meaning.remedy}"
            for axis in self._axes
            for bit, meaning in CONDITIONS.items()
            if axis.status & bit
        ]
        return Complaint(f"no power although it was enabled: {' '.join(why)}")

    # ----------------------------------------------------------------------------------------- homing

    @property
    @override
    def is_homed(self) -> bool:
        return not self._unhomed and all(
            self._axes[place].trajectory & Trajectory.REFERENCED for place in self.homes
        )

    @override
    def home(self, place: int) -> Generator[None, None, Complaint | None]:
        self._halting.moves()
        return (yield from self._procedures.home(self._axes[place]))

    @override
    def homed(self) -> Steps:
        ended = time.monotonic()  # what is measured before may count from another place
        if not (yield from until(lambda: self._sampled > ended, REST)):
            raise TransitionFailed(
                "no position comes after homing", where=self.where, remedy="Home once more."
            )
        self._unhomed = False

    @override
    def unhome(self) -> Steps:
        self._unhomed = True
        yield from ()


def _tracking(config: CopleyConfig, line: Line, axes: Sequence[Axis]) -> Tracking:
    if config.tracking == "pvt":
        return ByPvt(line, axes, round(config.pvt_period, 3), config.pvt_lead)
    return ByProfile(line, axes, rests=config.tracking == "stop_go")


def _capabilities(config: CopleyConfig, *, needs_homing: bool) -> Capabilities:
    joints = config.joints
    braking = braking_time(joints.values())
    delay = delay_of(config.pvt_period, config.pvt_lead)
    homing = [joint.homing.timeout for joint in joints.values() if joint.homing is not None]
    return promises(
        joints,
        rate=config.carried,
        units=[VELOCITY_UNIT / joint.counts for joint in joints.values()],
        lag={"pvt": delay + 0.6, "profile": 0.3, "stop_go": 2.0}[config.tracking],
        runs_on=delay + braking if config.tracking == "pvt" else braking,
        stops="comes to rest when its buffer is empty, or at the last position that it was sent; t 0 slows "
        "it down within its acceleration",
        needs_homing=needs_homing,
        transition_timeout=TRANSITION + sum(homing),
    )
