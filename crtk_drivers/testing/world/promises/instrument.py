"""A device under test that measures: its driver, its simulator, and what acts on that.

Where a device with joints has a `Subject`, a force sensor has a `ForceSensor` and a tracker an `Instrument`.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from typing_extensions import override

from crtk_drivers.engine import Engine
from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import Pose, Stamp, Value, Wrench
from crtk_drivers.testing.world.promises.subject import PERIOD, Installed, Setting
from crtk_drivers.testing.world.world import World

_REMEMBERED: Final = 1000
_CALM_SHARE: Final = 0.25
"""Share of the changes after which nothing changes for a while: a bias needs that."""
_CALM: Final = 1.2
"""s that this lasts."""

Numbers = tuple[float, ...]


class Missing(NamedTuple):
    """There is nothing to be measured now.

    Attributes:
        numbers: of what is there all the same, and measured once it is seen again; None: nothing is.
    """

    numbers: Numbers | None = None


Truth = Mapping[str, Numbers | Missing]
"""What is to be measured, by reading: ``raw/measured_cf``, ``pointer.measured_cp``."""


@dataclass(frozen=True, kw_only=True)
class Instrument(Installed):
    """A device that measures, and what is true of it in its simulator.

    Attributes:
        truth: returns what it has to measure now, in the numbers of each reading.
        change: lets something else act on the simulator from now on, and says what.
        rest: s from one change to the next, most often.
        error: by how much each number of a reading may be off: resolution, noise.
        early: s before its stamp at which a value may have been measured, by the device's documentation.
        late: s after its stamp at which it may have been.
        sends: whether the simulator sends without being asked now.
    """

    truth: Callable[[Any], Truth]
    change: Callable[[Any, random.Random], str]
    rest: float = 0.3
    error: Sequence[float]
    early: float
    late: float
    sends: Callable[[Any], bool]


@dataclass(frozen=True, kw_only=True)
class ForceSensor(Instrument):
    """A sensor of forces, which has a software bias.

    Attributes:
        bias: returns the bias in force, from the driver's device.
        drift: N and N·m that a load may change by while a bias is set.
    """

    bias: Callable[[Any], Sequence[float]]
    drift: Sequence[float]


RAW: Final = "raw/measured_cf"
BIASED: Final = "measured_cf"


class Found(NamedTuple):
    """What a driver publishes: the numbers of a reading, their stamp, and s after which they are stale."""

    numbers: Numbers
    stamp: Stamp
    stale_after: float


class Span(NamedTuple):
    """Between which two each number was in some time, and whether there was nothing to be measured at all."""

    lower: Numbers
    upper: Numbers
    is_missing: bool

    def has(self, numbers: Sequence[float], error: Sequence[float]) -> bool:
        """Return whether numbers are in it, or off by an error at most."""
        return all(
            low - off <= number <= high + off
            for low, number, high, off in zip(self.lower, numbers, self.upper, error, strict=True)
        )


class History:
    """What was so, and since when. It is asked of times that are not far away."""

    def __init__(self) -> None:
        self._entries: deque[tuple[float, Numbers | Missing]] = deque(maxlen=_REMEMBERED)

    def note(self, now: float, numbers: Numbers | Missing) -> None:
        """Note what is so now."""
        if not self._entries or self._entries[-1][1] != numbers:
            self._entries.append((now, numbers))

    def between(self, begin: float, end: float) -> Iterator[Numbers | Missing]:
        """Yield what was so at any time from `begin` to `end` (s), the newest first."""
        for since, numbers in reversed(self._entries):
            if since <= end:
                yield numbers
            if since <= begin:
                return

    def span(self, begin: float, end: float) -> Span | None:
        """Return between which two numbers it was; None: nobody looked yet."""
        seen = list(self.between(begin, end))
        if not seen:
            return None
        places = [each.numbers if isinstance(each, Missing) else each for each in seen]
        columns = list(zip(*(each for each in places if each is not None), strict=True))
        lower, upper = tuple(map(min, columns)), tuple(map(max, columns))
        return Span(lower, upper, is_missing=all(isinstance(each, Missing) for each in seen))


class Sight(Setting):
    """An instrument in a world: what acts on it is looked at all the time, and changes at random.

    Args:
        world: in which it is.
        instrument: that is tested.

    Attributes:
        acting: what is to be measured, by reading.
        biases: the software bias of a force sensor; empty of others.
        changed: when something else began to act (s).
    """

    def __init__(self, world: World, instrument: Instrument) -> None:
        super().__init__(world, instrument)
        self.instrument = instrument
        self.acting: dict[str, History] = {}
        self.biases = History()
        self.changed = world.now
        self._resets = 0
        self._draw = world.kernel.stream("acting")
        self.look()
        self._plan()

    @override
    def look(self) -> None:
        """Look what acts on it, which bias is in force, and who stands still."""
        super().look()
        instrument, now = self.instrument, self.now
        resets, self._resets = self._resets, self.world.troubles.struck["reset"]
        if self._resets != resets:
            self.hindered = now  # a connection that is lost carries no request to stop
        if self.sim.running:
            for name, numbers in instrument.truth(self._server).items():
                self.acting.setdefault(name, History()).note(now, numbers)
        if isinstance(instrument, ForceSensor) and self.engine is not None:
            self.biases.note(now, self.bias())

    @override
    def connect(self) -> LocalDevice:
        arm = super().connect()
        self.look()  # before a user sets another bias
        return arm

    def bias(self) -> Numbers:
        """Return the software bias of a force sensor."""
        instrument, engine = self.instrument, self.engine
        assert isinstance(instrument, ForceSensor)
        assert engine is not None
        return tuple(map(float, instrument.bias(engine.device)))

    def _plan(self) -> None:
        """Let something else act after a while, again and again."""
        draw, usual = self._draw, self.instrument.rest
        rest = _CALM if draw.random() < _CALM_SHARE else 2.0 * usual * draw.random()

        def change() -> None:
            if self.sim.running:
                self.world.say(self.instrument.change(self._server, draw))
                self.changed = self.now
                self.look()  # before it changes again
            self._plan()

        self.world.kernel.after(rest, change)

    @property
    def sends(self) -> bool:
        """Whether the simulator sends without being asked now."""
        return self.sim.running and self.instrument.sends(self._server)

    def found(self, reading: str) -> Found | None:
        """Return what the driver publishes of a reading as valid now; None: nothing."""
        found = None if self.arm is None else _told(self.arm, reading)
        if found is None:
            return None
        engine, value, stamp = found
        if not stamp.wall_ns:
            return None
        return Found(_numbers(value), stamp, engine.stale_after)

    def was(self, reading: str, begin: float, end: float) -> Span | None:
        """Return what was to be measured between two times (s); None: it is not known."""
        history = self.acting.get(reading)
        return None if history is None else history.span(begin - PERIOD, end + PERIOD)


def _told(arm: LocalDevice, reading: str) -> tuple[Engine, Value, Stamp] | None:
    child, _, name = reading.rpartition(".")
    engine = (arm.child(child) if child else arm).engine
    found = engine.feedback(name)
    return None if found is None else (engine, *found)


def _numbers(value: Value) -> Numbers:
    if isinstance(value, Pose):
        turned = value.orientation.tolist()
        sign = math.copysign(1.0, turned[3])  # a quaternion and its negative are one turn
        return (*value.position.tolist(), *(sign * part for part in turned))
    assert isinstance(value, Wrench)
    return tuple(value.vector.tolist())
