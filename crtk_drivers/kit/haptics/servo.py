"""The process that owns a vendor's library: reads, steps the force loop, writes; it waits for nobody.

The driver's process may hang, or be killed: it is heard within `Timing.driver_timeout`, or forces are zero,
and its end closes the device. This process may hang or be killed too: then the device has to see to it.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Protocol

from typing_extensions import override

from crtk_drivers.kit.child_process import Parent
from crtk_drivers.kit.haptics import child_messages
from crtk_drivers.kit.haptics.child_messages import Flags, Kind, State
from crtk_drivers.kit.haptics.fixtures import Motion, Spring, fixtures_from
from crtk_drivers.kit.haptics.force_loop import ForceLimits, ForceLoop
from crtk_drivers.kit.haptics.passivity import TankLimits
from crtk_drivers.kit.haptics.triples import ZERO, Triple
from crtk_drivers.status.real_time import ask_for_real_time

__all__ = ["Hand", "HandError", "HandReading", "HandState", "Servo", "Timing"]

PRIORITY: Final = 15
"""Of SCHED_FIFO: above the driver's own threads, which wait for this."""
LOOK: Final = 0.02
"""s between two looks at what the device says of itself."""
FORGIVEN: Final = 10.0
"""s in which the watchdog of a device may end forces `Timing.trips` times, which then rise by themselves."""
STOOD: Final = 0.5
"""s after which that is not forgiven: nobody knows what has happened meanwhile."""
FIRST_WORD: Final = 30.0
"""s in which the driver says what is to be opened."""


class HandError(Exception):
    """A call of a vendor's library failed.

    Args:
        text: what happened.
        remedy: what to do next.
    """

    def __init__(self, text: str, remedy: str = "") -> None:
        super().__init__(text)
        self.text = text
        self.remedy = remedy


class HandReading(NamedTuple):
    """What is read in a cycle; see `State`."""

    motion: Motion
    force: Triple = ZERO
    torque: Triple = ZERO
    gripper: float = 0.0
    gripper_speed: float = 0.0
    gripper_force: float = 0.0
    buttons: int = 0


class HandState(NamedTuple):
    """What a device says of itself.

    Attributes:
        is_initialized: it knows where it is.
        forces_on: forces go out.
        cause: why they do not, in words.
        is_late: they do not since its watchdog heard nothing in time.
        is_fault: it must be attended to; else somebody at the device has switched them off.
        carries_weight: its gravity compensation is on.
    """

    is_initialized: bool
    forces_on: bool
    cause: str = ""
    is_late: bool = False
    is_fault: bool = False
    carries_weight: bool = False


class Hand(Protocol):
    """A device by a vendor's library. All of it may raise HandError."""

    def open(self, options: Mapping[str, Any]) -> Mapping[str, Any]:
        """Open it, its forces off, and return what to tell of it."""

    def close(self) -> None:
        """Zero forces, and let go of it. May be called twice."""

    def read(self) -> HandReading:
        """Return what is measured."""

    def state(self) -> HandState:
        """Return what it says of itself."""

    def push(self, force: Triple, torque: Triple, grip: float) -> bool:
        """Set forces; return whether a motor is at its limit."""

    def enable(self, on: bool) -> None:
        """Switch forces on or off."""

    def use_gravity_compensation(self, on: bool) -> None:
        """Carry the device's own weight, or do not."""

    def home(self) -> None:
        """Let it find where it is. It moves, and this returns when that is done. In a thread of its own."""

    def end_homing(self) -> None:
        """Let `home` end. In another thread than that."""


@dataclass(frozen=True, slots=True)
class Timing:
    """How fast it goes.

    Attributes:
        rate: Hz of the loop.
        told: cycles between two that are told.
        driver_timeout: s without a word of the driver after which forces are zero.
        grip: N of the gripper at most.
        trips: of the device's watchdog in `FORGIVEN` s after which forces rise again without being enabled.
    """

    rate: float
    told: int
    driver_timeout: float
    grip: float
    trips: int = 0


class Servo:
    """The main loop.

    Args:
        parent: the driver.
        hand: the device.
    """

    def __init__(self, parent: Parent, hand: Hand) -> None:
        self._parent = parent
        self._hand = hand
        self._timing = Timing(1000.0, 4, 0.1, 0.0)
        self._limits = ForceLimits(force=1.0)
        self._loop = ForceLoop(self._limits)
        self._follow: dict[str, float] = {}
        self._state = State(0.0, Motion(ZERO))
        self._device = HandState(False, False)
        self._looked = self._heard = self._grip_at = 0.0
        self._is_enabled = self._has_power = self._is_forgotten = self._is_saturated = False
        self._grip = 0.0
        self._done = 0
        self._homing: _Homing | None = None
        self._cycles = self._late = self._trips = self._silences = 0
        self._was_heard = True
        self._acted = False
        self._tripped: deque[float] = deque()
        self._unsaid: deque[bytes] = deque()
        self._longest = 0.0

    def run(self) -> None:
        """Work until the driver ends, or the device is lost."""
        try:
            if self._open():
                ask_for_real_time(PRIORITY)
                self._go_on()
        except HandError as error:
            self._say(
                child_messages.text(Kind.FAILED, 0, {"text": error.text, "remedy": error.remedy})
            )
        finally:
            if self._homing is not None:
                with contextlib.suppress(HandError):
                    self._hand.end_homing()
            with contextlib.suppress(HandError):
                self._hand.close()

    def _open(self) -> bool:
        for message in self._parent.receive(FIRST_WORD) or ():
            _, options = child_messages.text_of(message)
            self._timing = Timing(**options["timing"])
            self._limits = ForceLimits(**options["limits"])
            tank = TankLimits(**options["tank"], period=1.0 / self._timing.rate)
            self._loop = ForceLoop(self._limits, tank)
            self._follow = dict(options["follow"])
            told = self._hand.open(options["hand"])
            self._say(child_messages.text(Kind.OPENED, 0, told))
            return True
        return False

    def _go_on(self) -> None:
        period = 1.0 / self._timing.rate
        due = self._heard = time.monotonic()
        while (orders := self._parent.receive()) is not None:
            now = time.monotonic()
            if orders:
                self._heard = now
            for message in orders:
                self._take(message, now)
            self._cycle(now)
            ended = time.monotonic()
            self._longest = max(self._longest, ended - now)
            due += period
            if ended < due:
                time.sleep(due - ended)
            elif ended > due + period:
                self._late += 1
                due = ended

    # ---------------------------------------------------------------------------------------- a cycle

    def _cycle(self, now: float) -> None:
        self._cycles += 1
        if self._homing is not None:
            if now - self._heard > self._timing.driver_timeout:
                self._end_homing("homing was ended: nobody was heard who could have stopped it")
            else:
                self._look_at_homing(self._homing, now)
        else:
            if now - self._looked >= LOOK:
                self._look(now)
            self._move(now)
        if self._cycles % self._timing.told == 0:
            self._tell()

    def _look(self, now: float) -> None:
        """See whether forces go out; those that its watchdog has ended begin from zero again."""
        stood, self._looked = now - self._looked, now
        self._device = state = self._hand.state()
        if not self._has_power or state.forces_on:
            return
        if state.is_late and self._is_forgiven(now, stood):
            self._hand.push(ZERO, ZERO, 0.0)
            self._hand.enable(True)
            self._loop.begin_anew(now)
            return
        self._loop.disable()
        self._is_enabled = self._has_power = False
        told = {"text": state.cause, "is_fault": state.is_fault}
        self._say(child_messages.text(Kind.WITHDRAWN, 0, told))
        # Whoever lets them go out again at the device finds none.
        self._hand.push(ZERO, ZERO, 0.0)
        self._hand.enable(False)

    def _is_forgiven(self, now: float, stood: float) -> bool:
        """Count a trip of the watchdog, and return whether it is one that happens on a busy computer."""
        self._trips += 1
        while self._tripped and now - self._tripped[0] > FORGIVEN:
            self._tripped.popleft()
        self._tripped.append(now)
        return stood <= STOOD and len(self._tripped) <= self._timing.trips

    def _move(self, now: float) -> None:
        reading = self._hand.read()
        force, torque = ZERO, ZERO
        is_heard = now - self._heard <= self._timing.driver_timeout
        self._silences += self._was_heard and not is_heard
        self._was_heard = is_heard
        acts = self._is_enabled and self._knows_where and is_heard
        if acts and not self._acted:
            self._loop.begin_anew(now)
        self._acted = acts
        if acts:
            force, torque = self._loop.step(reading.motion, now)
        if now - self._grip_at > self._limits.command_timeout or not self._is_enabled:
            self._grip = 0.0
        if self._has_power:
            grip = self._grip if is_heard and reading.motion.is_possible else 0.0
            self._is_saturated = self._hand.push(force, torque, grip * self._loop.strength)
        self._state = State(now, *reading)

    @property
    def _knows_where(self) -> bool:
        return self._device.is_initialized and not self._is_forgotten

    def _say(self, message: bytes) -> None:
        """Tell what may not be missed: again, before anything else, where the driver does not read."""
        self._unsaid.append(message)
        self._say_all()

    def _say_all(self) -> bool:
        while self._unsaid:
            if not self._parent.send(self._unsaid[0]):
                return False
            self._unsaid.popleft()
        return True

    def _tell(self) -> None:
        if not self._say_all():
            return
        counts = (
            self._cycles,
            self._late,
            self._loop.tank.reduced,
            self._trips,
            self._silences,
        )
        flags = (
            Flags.INITIALIZED * self._knows_where
            | Flags.ENABLED * self._is_enabled
            | Flags.HOMING * (self._homing is not None)
            | Flags.SATURATED * self._is_saturated
            | Flags.WEIGHTLESS * self._device.carries_weight
        )
        self._parent.send(
            child_messages.state(
                self._state._replace(
                    flags=Flags(flags), done=self._done, counts=counts, longest=self._longest
                )
            )
        )

    # ----------------------------------------------------------------------------------------- homing

    def _look_at_homing(self, homing: _Homing, now: float) -> None:
        self._state = self._state._replace(time=now)
        if homing.is_alive():
            return
        self._homing = None
        self._looked = now
        self._look(now)
        error = homing.error
        if error is None:
            self._is_forgotten = False
            if not self._device.is_initialized:
                error = HandError("it does not know where it is still", "Send home again.")
        self._reply(homing.number, error)
        if self._has_power:
            self._loop.begin_anew(now)

    def _home(self, number: int) -> None:
        if self._homing is not None:
            raise HandError("it is homing already")
        self._loop.release()
        self._hand.push(ZERO, ZERO, 0.0)
        self._homing = _Homing(self._hand.home, number)
        self._homing.start()

    # ----------------------------------------------------------------------------------------- orders

    def _take(self, message: bytes, now: float) -> None:
        kind = Kind(message[:1])
        if kind is Kind.FIXTURES:
            number, content = child_messages.text_of(message)
            self._loop.use(fixtures_from(content["text"]))
        else:
            number, values = child_messages.order_of(message)
            try:
                self._obey(kind, number, values, now)
            except HandError as error:
                if kind not in _REPLIED:
                    raise
                self._reply(number, error)
                self._done = number
                return
        self._done = number
        if kind in _REPLIED and kind is not Kind.HOME:
            self._reply(number, None)

    def _obey(self, kind: Kind, number: int, values: tuple[float, ...], now: float) -> None:
        if kind is Kind.ENABLE:
            self._hand.push(ZERO, ZERO, 0.0)
            self._hand.enable(True)
            self._has_power = self._is_enabled = True
            self._loop.enable(now)
        elif kind in (Kind.DISABLE, Kind.PAUSE):
            self._is_enabled = False
            self._loop.disable()
            self._end_homing()
            if kind is Kind.DISABLE:
                self._has_power = False
                try:
                    self._hand.push(ZERO, ZERO, 0.0)
                finally:
                    self._hand.enable(False)
        elif kind is Kind.STOP:
            self._loop.release()
            self._grip = 0.0
            self._end_homing()
        elif kind is Kind.HOME:
            self._home(number)
        elif kind is Kind.UNHOME:
            self._is_forgotten = True
        elif kind is Kind.GRAVITY:
            self._hand.use_gravity_compensation(bool(values[0]))
        elif kind is Kind.WRENCH:
            self._loop.command(
                (values[0], values[1], values[2]), (values[3], values[4], values[5]), now
            )
        elif kind is Kind.POSE:
            point = (values[0], values[1], values[2])
            turned = (values[3], values[4], values[5], values[6])
            self._loop.follow(Spring(point, turned, **self._follow), now)
        elif kind is Kind.GRIP:
            if not math.isfinite(values[0]):
                raise ValueError(f"no finite force of the gripper: {values[0]}")
            most = self._timing.grip
            self._grip, self._grip_at = max(-most, min(most, values[0])), now

    def _end_homing(self, why: str = "") -> None:
        """Let it end now; what does not is ended with this process."""
        homing = self._homing
        if homing is not None:
            # Again and again: it may not have begun to move when it is told first.
            for _ in range(_TOLD_TO_END):
                self._hand.end_homing()
                homing.join(_ENDS / _TOLD_TO_END)
                if not homing.is_alive():
                    break
            else:
                raise SystemExit("homing did not end when it was told to")
            if why and homing.error is not None:
                homing.error = HandError(why, "Send home again.")
            self._look_at_homing(homing, time.monotonic())

    def _reply(self, number: int, error: HandError | None) -> None:
        told = {} if error is None else {"text": error.text, "remedy": error.remedy}
        self._say(child_messages.text(Kind.REPLY, number, told))


_REPLIED: Final = frozenset({Kind.ENABLE, Kind.DISABLE, Kind.HOME, Kind.UNHOME, Kind.GRAVITY})
"""Orders whose end the driver is told."""
_ENDS: Final = 0.3
"""s in which homing ends that was told to."""
_TOLD_TO_END: Final = 15
"""times in that."""


class _Homing(threading.Thread):
    """Homes, which takes seconds, beside the loop."""

    def __init__(self, home: Callable[[], None], number: int) -> None:
        super().__init__(name="homing", daemon=True)
        self._home = home
        self.number = number
        self.error: HandError | None = None

    @override
    def run(self) -> None:
        """Home it."""
        try:
            self._home()
        except HandError as error:
            self.error = error
        except Exception as error:  # else it would have homed
            self.error = HandError(f"homing broke: {error!r}")
