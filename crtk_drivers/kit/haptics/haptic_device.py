"""A haptic device as a CRTK device, whatever its library: orders to its process, and what that tells."""

from __future__ import annotations

import itertools
import json
import logging
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, Final

from typing_extensions import override

from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Answer,
    Capabilities,
    CartesianLimits,
    Condition,
    Device,
    Input,
    Mode,
    Note,
    Reading,
    Service,
    Setpoint,
    Severity,
    Steps,
)
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    ConnectionLost,
    DeviceError,
    DeviceFault,
    Reason,
    TransitionFailed,
)
from crtk_drivers.kit.child_process import ChildProcess
from crtk_drivers.kit.haptics import child_messages
from crtk_drivers.kit.haptics.child_messages import Flags, Kind, State
from crtk_drivers.kit.haptics.fixtures import Motion, fixtures_from
from crtk_drivers.kit.haptics.haptic_gripper import GRIPPER, HapticGripper
from crtk_drivers.kit.haptics.traits import Traits
from crtk_drivers.kit.waiting_steps import until
from crtk_drivers.samples import (
    Flag,
    JointState,
    Joy,
    Pose,
    Sample,
    Stamp,
    Text,
    Twist,
    Vector,
    Wrench,
    vector,
)
from crtk_drivers.state import OperatingState

__all__ = ["HapticDevice"]

log = logging.getLogger(__name__)

ALIVE: Final = 0.02
"""s between two words to the process."""
REPLIES: Final = 3.0
"""s in which an order that moves nothing is carried out."""
FAREWELL: Final = 0.5
"""s in which the process ends by itself."""
TAKES: Final = 0.5
"""s in which gravity compensation is as it was asked for."""
STALE: Final = 0.25
"""s after which buttons are not known any more."""
_COUNTS: Final = (
    "cycles",
    "late cycles",
    "forces reduced for passivity",
    "watchdog of the device",
    "silences of the driver",
)


class HapticDevice(Device):
    """One device.

    Args:
        traits: what is particular about it.
    """

    def __init__(self, traits: Traits) -> None:
        self._traits = traits
        self._child = ChildProcess(traits.module, traits.address)
        self._numbers = itertools.count(1)
        self._in_order = threading.Lock()
        self._state = State(0.0, Motion((0.0, 0.0, 0.0)))
        self._about: Mapping[str, Any] = {}
        self._replies: dict[int, DeviceFault | None] = {}
        self._awaited: set[int] = set()
        self._withdrawn = Condition()
        self._fixtures = "{}"
        self._new_fixtures: str | None = None
        self._stopped = 0
        self._weight: tuple[float, bool] | None = None
        """When (monotonic s) gravity compensation was switched, and whether on."""
        self._spoke = 0.0
        self._gives_up = self.is_open = False
        self._gripper = HapticGripper(self, traits) if traits.has_gripper else None
        rate = min(traits.rate, traits.loop_rate)
        self._told = max(1, round(traits.loop_rate / rate))
        self._capabilities = Capabilities(
            modes=frozenset({Mode.CARTESIAN_EFFORT, Mode.CARTESIAN_POSITION}),
            measured=("measured_cp", "measured_cv", "measured_cf"),
            cartesian_limits=CartesianLimits(
                linear_velocity=1.0,
                angular_velocity=10.0,
                linear_acceleration=20.0,
                angular_acceleration=200.0,
                force=traits.limits.force,
                torque=traits.limits.torque,
            ),
            has_gravity_compensation=traits.has_gravity_compensation,
            needs_homing=True,
            rate=traits.loop_rate / self._told,
            paced_by_stream=True,
            base_frame=traits.frame_id,
            tool_frame=f"{traits.frame_id}_hand",
            transition_timeout=traits.home_timeout + 5.0,
            stop=traits.stop,
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return self._traits.address

    # ------------------------------------------------------------------------------------ the process

    @override
    def open(self, deadline: float) -> None:
        self._replies.clear()
        self._withdrawn, self._stopped, self._weight = Condition(), 0, None
        self._state = State(0.0, Motion((0.0, 0.0, 0.0)))
        self._child.start()
        self._child.send(child_messages.text(Kind.OPEN, 0, self._options()))
        self._about = {}
        try:
            while not self._state.time:
                if self._gives_up or time.monotonic() > deadline:
                    raise ConnectionFailed(
                        "its process does not answer",
                        where=self.address,
                        remedy="Is the machine busy, or does the library hang? It is tried again.",
                    )
                self.hear(min(deadline, time.monotonic() + 0.1))
        except ConnectionLost as error:
            raise ConnectionFailed(
                error.message, where=self.address, remedy=error.remedy
            ) from error
        finally:
            if not self._state.time:
                self._child.kill()
        self._new_fixtures = self._fixtures
        self.is_open = True

    def _options(self) -> dict[str, Any]:
        traits, tank = self._traits, asdict(self._traits.tank)
        del tank["period"]
        timing = {
            "rate": traits.loop_rate,
            "told": self._told,
            "driver_timeout": traits.driver_timeout,
            "grip": traits.grip,
            "trips": traits.trips,
        }
        return {
            "hand": dict(traits.hand),
            "timing": timing,
            "limits": asdict(traits.limits),
            "tank": tank,
            "follow": dict(traits.follow),
        }

    @override
    def abort_open(self) -> None:
        self._gives_up = True

    @override
    def close(self) -> None:
        self.is_open = False
        self.end_process()

    def end_process(self) -> None:
        """End the process, unless device or gripper are open still; `open` replaces it in any case."""
        if not (self.is_open or (self._gripper is not None and self._gripper.is_open)):
            self._child.close(FAREWELL)

    def _order(self, kind: Kind, values: Sequence[float] = ()) -> int:
        """Send an order and return its number. From any thread."""
        with self._in_order:  # a stop counts as carried out when a later order is
            number = next(self._numbers)
            self._child.send(child_messages.order(kind, number, values))
        self._spoke = time.monotonic()
        return number

    def hear(self, deadline: float) -> bool:
        """Take what the process has told, and return whether a state was among it.

        Raises:
            ConnectionLost: it has ended, or the device is lost.
        """
        states = 0
        for message in self._child.receive(deadline):
            kind = Kind(message[:1])
            if kind is Kind.STATE:
                self._state = child_messages.state_of(message)
                states += 1
                continue
            number, told = child_messages.text_of(message)
            if kind is Kind.OPENED:
                self._about = told
            elif kind is Kind.FAILED:
                raise ConnectionLost(told["text"], where=self.address, remedy=told["remedy"])
            elif kind is Kind.REPLY:
                self._take_reply(number, told)
            elif kind is Kind.WITHDRAWN:
                state = OperatingState.FAULT if told["is_fault"] else OperatingState.PAUSED
                self._withdrawn = Condition(state, told["text"])
        return states > 0

    def _take_reply(self, number: int, told: Mapping[str, str]) -> None:
        fault = DeviceFault(told["text"], remedy=told["remedy"]) if told else None
        if number in self._awaited:
            self._replies[number] = fault
        elif fault is not None:
            log.warning("%s: %s", self.address, fault.message)

    @override
    def read(self, deadline: float) -> Sample | None:
        if self._new_fixtures is not None:
            text, self._new_fixtures = self._new_fixtures, None
            with self._in_order:
                number = next(self._numbers)
                self._child.send(child_messages.text(Kind.FIXTURES, number, {"text": text}))
        elif time.monotonic() - self._spoke > ALIVE:
            self._order(Kind.ALIVE)
        if not self.hear(deadline):
            return None
        return Sample(self._stamp(), self._values() if self._is_measured else {})

    @property
    def _is_measured(self) -> bool:
        return Flags.HOMING not in self._state.flags and Flags.INITIALIZED in self._state.flags

    def _stamp(self) -> Stamp:
        return Stamp.at(self._state.time)

    def _values(self) -> dict[str, Pose | Twist | Wrench]:
        told, frame = self._state, self._traits.frame_id
        motion = told.motion
        return {
            "measured_cp": Pose(vector(motion.position), vector(motion.orientation), frame),
            "measured_cv": Twist(vector(motion.velocity), vector(motion.turning), frame),
            "measured_cf": Wrench(vector(told.force), vector(told.torque), frame),
        }

    # ----------------------------------------------------------------------------------------- forces

    @override
    def write(self, setpoint: Setpoint) -> None:
        if not self._is_measured:
            raise CommandRefused(
                "servo",
                Reason.NOT_MEASURED,
                "it does not know where it is",
                where=self.address,
                remedy="Send home, which moves it, and wait until is_homed.",
            )
        is_force = setpoint.mode is Mode.CARTESIAN_EFFORT
        self._order(Kind.WRENCH if is_force else Kind.POSE, setpoint.values.tolist())

    @override
    def stop(self) -> None:
        self._stopped = self._order(Kind.STOP)

    @property
    @override
    def has_stopped(self) -> bool:
        return self._state.done >= self._stopped

    @override
    def left(self) -> None:
        try:
            self._order(Kind.PAUSE)
        except DeviceError as error:
            log.warning("%s; the device ends its forces by itself", error)

    def _carried_out(
        self, kind: Kind, timeout: float = REPLIES, values: Sequence[float] = ()
    ) -> Steps:
        """Send an order and wait until it is told that it was carried out."""
        number = self._order(kind, values)
        self._awaited.add(number)
        try:
            if not (yield from until(lambda: number in self._replies, timeout)):
                raise TransitionFailed(
                    f"it did not {kind.name.lower()} in {timeout:g} s",
                    where=self.address,
                    remedy="Look at the device, and send it again.",
                )
            fault = self._replies[number]
        finally:
            self._awaited.discard(number)
            self._replies.pop(number, None)
        if fault is not None:
            raise TransitionFailed(fault.message, where=self.address, remedy=fault.remedy)

    # ------------------------------------------------------------------------------------------ state

    @property
    @override
    def condition(self) -> Condition:
        return self._withdrawn

    @property
    @override
    def is_homed(self) -> bool:
        return Flags.INITIALIZED in self._state.flags and Flags.HOMING not in self._state.flags

    @override
    def enable(self) -> Steps:
        self._withdrawn = Condition()
        is_enabled = False
        try:
            yield from self._carried_out(Kind.ENABLE)
            is_enabled = yield from until(lambda: Flags.ENABLED in self._state.flags, REPLIES)
            if not is_enabled:
                raise TransitionFailed(
                    f"its forces stay off: {self._withdrawn.reason or 'it does not say why'}",
                    where=self.address,
                    remedy="Look at its force button and its power.",
                )
        finally:
            if not is_enabled:  # nobody heard it, and forces may be on
                self.left()

    @override
    def disable(self) -> Steps:
        self._withdrawn = Condition()
        yield from self._carried_out(Kind.DISABLE)

    @override
    def pause(self) -> Steps:
        number = self._order(Kind.PAUSE)
        if not (yield from until(lambda: self._state.done >= number, REPLIES)):
            raise TransitionFailed(
                f"it did not pause in {REPLIES:g} s", where=self.address, remedy="Send disable."
            )

    @override
    def home(self) -> Steps:
        try:
            yield from self._carried_out(Kind.HOME, self._traits.home_timeout)
        except TransitionFailed:
            self.left()  # FAULT follows, in which somebody may put it where it is calibrated
            raise
        yield from until(lambda: self.is_homed, REPLIES)

    @override
    def unhome(self) -> Steps:
        yield from self._carried_out(Kind.UNHOME)
        yield from until(lambda: not self.is_homed, REPLIES)

    @override
    def use_gravity_compensation(self, on: bool) -> None:
        self._weight = time.monotonic(), on
        self._order(Kind.GRAVITY, (float(on),))

    # ----------------------------------------------------------------------------------- beyond CRTK

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        return {
            "fixtures": Input(
                "what pulls and pushes the hand: JSON, see docs/haptics.md",
                Payload.TEXT,
                self._take_fixtures,
            )
        }

    def _take_fixtures(self, value: Text) -> None:
        try:
            fixtures_from(value.value)
        except ValueError as error:
            raise CommandRefused(
                "fixtures",
                Reason.OUT_OF_RANGE,
                str(error),
                where=self.address,
                remedy='For example {"floor": {"kind": "wall", "point": [0, 0, 0], "normal": [0, 0, 1], '
                '"stiffness": 500}}; see docs/haptics.md.',
            ) from error
        self._fixtures = self._new_fixtures = value.value

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        return {"clear_fixtures": Service("take all fixtures away", self._clear_fixtures)}

    def _clear_fixtures(self) -> Answer:
        had = list(json.loads(self._fixtures))
        self._fixtures = self._new_fixtures = "{}"
        yield
        return f"taken away: {', '.join(had)}" if had else "there were none"

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        pressed = {
            name: Reading(
                "1 while it is pressed", Payload.JOY, partial(self._button, bit), True, True
            )
            for name, bit in self._traits.buttons.items()
        }
        now = Reading("fixtures that count now", Payload.TEXT, lambda: Text(self._fixtures))
        carried = Reading("whether it carries its own weight", Payload.FLAG, self._tell_weight)
        weight = {"gravity_compensation": carried} if self._traits.has_gravity_compensation else {}
        return {**pressed, **weight, "fixtures": now}

    def _tell_weight(self) -> Flag | None:
        return Flag(Flags.WEIGHTLESS in self._state.flags) if self.is_open else None

    @property
    def _is_weight_as_asked(self) -> bool:
        """Whether the device does what it was told last, as far as it had time to."""
        if self._weight is None:
            return True
        at, on = self._weight
        is_fresh = self._state.time - at > TAKES
        return not is_fresh or on is (Flags.WEIGHTLESS in self._state.flags)

    def _button(self, bit: int) -> Joy:
        fresh = time.monotonic() - self._state.time <= STALE
        known = fresh and Flags.HOMING not in self._state.flags  # in which nothing is read
        return Joy(buttons=(int(known and bool(self._state.buttons >> bit & 1)),), is_valid=known)

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        notes = []
        if self._about:
            told = ", ".join(f"{name} {value}" for name, value in self._about.items())
            notes.append(Note(Severity.INFO, "device", told))
        if not self.is_open:
            return tuple(notes)
        if Flags.SATURATED in self._state.flags:
            notes.append(Note(Severity.WARNING, "motors", "at their limit"))
        if not self._is_weight_as_asked:
            text = "was switched, and the device tells that it is as before"
            notes.append(Note(Severity.WARNING, "gravity compensation", text))
        return tuple(notes)

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        counted: dict[str, float] = dict(zip(_COUNTS, self._state.counts, strict=True))
        return {
            **counted,
            "longest cycle (s)": self._state.longest,
            "processes": self._child.starts,
        }

    @property
    @override
    def children(self) -> Mapping[str, Device]:
        return {} if self._gripper is None else {GRIPPER: self._gripper}

    @property
    @override
    def followers(self) -> frozenset[str]:
        return frozenset(self.children)

    # ------------------------------------------------------------------------------- for its gripper

    @property
    def gripper_sample(self) -> Sample | None:
        """The joint of the gripper, nothing in it while the device homes; None while nothing is told."""
        told = self._state
        if not told.time:
            return None
        if Flags.HOMING in told.flags:
            return Sample(self._stamp())
        joint = JointState(_one(told.gripper), _one(told.gripper_speed), _one(told.gripper_force))
        return Sample(self._stamp(), {"measured_js": joint})

    def grip(self, force: float) -> int:
        """Let the gripper push with so many N, for `ForceLimits.command_timeout`; return the order."""
        if self._child.pid:  # else its forces have ended with its process
            return self._order(Kind.GRIP, (force,))
        return 0

    def has_taken(self, number: int) -> bool:
        """Whether an order was carried out, or has ended with the process."""
        return not self._child.pid or self._state.done >= number


def _one(value: float) -> Vector:
    return vector((value,))
