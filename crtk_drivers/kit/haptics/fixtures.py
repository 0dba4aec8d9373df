"""Virtual fixtures: what pulls and pushes a hand, and the energy that lies in it.

The words are those of CRTK's ``servo_ci`` (crtk_msgs/CartesianImpedance: stiffness and damping about a
reference); box and sphere are ours. Each is a spring with an energy, and a damper that only takes energy.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any, Final, NamedTuple, Protocol, TypeAlias

from crtk_drivers.kit.haptics.triples import (
    ZERO,
    Quadruple,
    Triple,
    dot,
    is_finite,
    minus,
    plus,
    size,
    times,
    turn,
)

MOST_STIFFNESS: Final = 20_000.0
"""N/m, and N·m/rad."""
MOST_DAMPING: Final = 200.0
"""N·s/m, and N·m·s/rad."""
MOST_FIXTURES: Final = 16
FURTHEST: Final = 10.0
"""m from the origin that a fixture may be."""
LONGEST_TEXT: Final = 20_000
LONGEST_ESCAPED: Final = 60_000
"""Characters of that as it goes to the process of the device, in one message, beyond ASCII escaped."""
LARGEST: Final = 1000.0
"""m, m/s and rad/s that a hand does not reach: a measurement with more is none."""

INSIDE: Final = "inside"
OUTSIDE: Final = "outside"


class Motion(NamedTuple):
    """Where a hand is and how it moves, in the base frame.

    Attributes:
        position: m.
        orientation: unit quaternion x, y, z, w.
        velocity: m/s.
        turning: rad/s, base axes.
    """

    position: Triple
    orientation: Quadruple = (0.0, 0.0, 0.0, 1.0)
    velocity: Triple = ZERO
    turning: Triple = ZERO

    @property
    def is_possible(self) -> bool:
        """Whether each number is one that a hand may have: finite, and less than `LARGEST`."""
        numbers = (*self.position, *self.orientation, *self.velocity, *self.turning)
        return all(-LARGEST < each < LARGEST for each in numbers)


class Pull(NamedTuple):
    """What a fixture does: its energy in J, force in N and torque in N·m."""

    energy: float = 0.0
    force: Triple = ZERO
    torque: Triple = ZERO


class Fixture(Protocol):
    """Something that acts on a hand."""

    def act(self, motion: Motion) -> Pull:
        """Return what it does to a hand that moves so."""


NOTHING: Final = Pull()


def _check(name: str, value: float, most: float) -> None:
    if not 0.0 <= value <= most:
        raise ValueError(f"{name} must be from 0 to {most:g}, not {value}")


def _check_place(name: str, place: Triple) -> None:
    if not (is_finite(place) and size(place) <= FURTHEST):
        raise ValueError(f"{name} must be within {FURTHEST:g} m of the origin, not {place}")


def _check_spring(stiffness: float, damping: float, prefix: str = "") -> None:
    _check(f"{prefix}stiffness", stiffness, MOST_STIFFNESS)
    _check(f"{prefix}damping", damping, MOST_DAMPING)


def _pushed(depth: float, away: Triple, motion: Motion, stiffness: float, damping: float) -> Pull:
    """Return the push of a surface on what is `depth` m in it: a unit vector `away`; it never pulls."""
    force = stiffness * depth - damping * dot(motion.velocity, away)
    return Pull(0.5 * stiffness * depth * depth, times(away, max(force, 0.0)))


@dataclass(frozen=True, slots=True)
class Spring:
    """A spring and a damper to a pose.

    Attributes:
        point: m.
        orientation: unit quaternion x, y, z, w.
        stiffness, damping: N/m, N·s/m.
        turn_stiffness, turn_damping: N·m/rad, N·m·s/rad.

    Raises:
        ValueError: not finite, or beyond its bound.
    """

    point: Triple
    orientation: Quadruple = (0.0, 0.0, 0.0, 1.0)
    stiffness: float = 0.0
    damping: float = 0.0
    turn_stiffness: float = 0.0
    turn_damping: float = 0.0

    def __post_init__(self) -> None:
        _check_place("point", self.point)
        if not abs(math.hypot(*self.orientation) - 1.0) <= 1e-3:
            raise ValueError(f"orientation must have a norm of 1, not {self.orientation}")
        _check_spring(self.stiffness, self.damping)
        _check_spring(self.turn_stiffness, self.turn_damping, "turn_")

    def act(self, motion: Motion) -> Pull:
        """See `Fixture.act`."""
        off = minus(self.point, motion.position)
        force = minus(times(off, self.stiffness), times(motion.velocity, self.damping))
        energy = 0.5 * self.stiffness * dot(off, off)
        if not (self.turn_stiffness or self.turn_damping):
            return Pull(energy, force)
        turned = turn(self.orientation, motion.orientation)
        torque = minus(times(turned, self.turn_stiffness), times(motion.turning, self.turn_damping))
        return Pull(energy + 0.5 * self.turn_stiffness * dot(turned, turned), force, torque)


@dataclass(frozen=True, slots=True)
class Wall:
    """A plane that is not passed.

    Attributes:
        point: on the plane, m.
        normal: into the free side; of any length but zero.
        stiffness, damping: N/m, N·s/m.

    Raises:
        ValueError: not finite, or beyond its bound.
    """

    point: Triple
    normal: Triple
    stiffness: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        _check_place("point", self.point)
        length = size(self.normal)
        if not 1e-6 < length < 1e6:
            raise ValueError(f"normal must have a direction, not {self.normal}")
        object.__setattr__(self, "normal", times(self.normal, 1.0 / length))
        _check_spring(self.stiffness, self.damping)

    def act(self, motion: Motion) -> Pull:
        """See `Fixture.act`."""
        depth = dot(minus(self.point, motion.position), self.normal)
        if depth <= 0.0:
            return NOTHING
        return _pushed(depth, self.normal, motion, self.stiffness, self.damping)


@dataclass(frozen=True, slots=True)
class Box:
    """A box along the base axes that is not left, or not entered.

    Attributes:
        lower, upper: opposite corners, m.
        keep: ``inside`` or ``outside``.
        stiffness, damping: N/m, N·s/m.

    Raises:
        ValueError: not finite, beyond its bound, or corners that are no box.
    """

    lower: Triple
    upper: Triple
    stiffness: float
    damping: float = 0.0
    keep: str = INSIDE

    def __post_init__(self) -> None:
        _check_place("lower", self.lower)
        _check_place("upper", self.upper)
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"lower {self.lower} must be below upper {self.upper} on each axis")
        _check_keep(self.keep)
        _check_spring(self.stiffness, self.damping)

    def act(self, motion: Motion) -> Pull:
        """See `Fixture.act`."""
        place = motion.position
        if self.keep == INSIDE:
            x, y, z = map(_beyond, place, self.lower, self.upper)
            depth = math.sqrt(x * x + y * y + z * z)
            away: Triple = (x, y, z)
        else:
            nearest = min(
                (min(p - low, high - p), axis, -1.0 if p - low < high - p else 1.0)
                for axis, (p, low, high) in enumerate(
                    zip(place, self.lower, self.upper, strict=True)
                )
            )
            depth, axis, sign = nearest
            away = (
                sign * depth * (axis == 0),
                sign * depth * (axis == 1),
                sign * depth * (axis == 2),
            )
        if depth <= 0.0:
            return NOTHING
        return _pushed(depth, times(away, 1.0 / depth), motion, self.stiffness, self.damping)


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere that is not left, or not entered.

    Attributes:
        center: m.
        radius: m.
        keep: ``inside`` or ``outside``.
        stiffness, damping: N/m, N·s/m.

    Raises:
        ValueError: not finite, or beyond its bound.
    """

    center: Triple
    radius: float
    stiffness: float
    damping: float = 0.0
    keep: str = INSIDE

    def __post_init__(self) -> None:
        _check_place("center", self.center)
        if not 0.0 < self.radius <= FURTHEST:
            raise ValueError(f"radius must be above 0, to {FURTHEST:g}, not {self.radius}")
        _check_keep(self.keep)
        _check_spring(self.stiffness, self.damping)

    def act(self, motion: Motion) -> Pull:
        """See `Fixture.act`."""
        off = minus(motion.position, self.center)
        distance = size(off)
        sign = -1.0 if self.keep == INSIDE else 1.0
        depth = sign * (self.radius - distance)
        if depth <= 0.0:
            return NOTHING
        # In the very centre no way out is nearer than another.
        out = times(off, 1.0 / distance) if distance > 1e-9 else (0.0, 0.0, 1.0)
        return _pushed(depth, times(out, sign), motion, self.stiffness, self.damping)


def _beyond(value: float, low: float, high: float) -> float:
    """Return the way back into a range."""
    return low - value if value < low else high - value if value > high else 0.0


def _check_keep(keep: str) -> None:
    if keep not in (INSIDE, OUTSIDE):
        raise ValueError(f"keep must be {INSIDE} or {OUTSIDE}, not {keep!r}")


Kind: TypeAlias = type[Spring] | type[Wall] | type[Box] | type[Sphere]

KINDS: Final[Mapping[str, Kind]] = {"spring": Spring, "wall": Wall, "box": Box, "sphere": Sphere}


def sum_of(fixtures: Mapping[str, Fixture], motion: Motion) -> Pull:
    """Return what all of them do together."""
    energy, force, torque = 0.0, ZERO, ZERO
    for fixture in fixtures.values():
        pull = fixture.act(motion)
        energy += pull.energy
        force = plus(force, pull.force)
        torque = plus(torque, pull.torque)
    return Pull(energy, force, torque)


def fixtures_from(text: str) -> dict[str, Fixture]:
    """Return the fixtures that a JSON text names.

    Args:
        text: an object of objects by name, each with ``kind`` and the attributes of that class:
            ``{"floor": {"kind": "wall", "point": [0, 0, 0], "normal": [0, 0, 1], "stiffness": 800}}``.

    Raises:
        ValueError: with what is wrong of which.
    """
    if len(text) > LONGEST_TEXT:
        raise ValueError(f"longer than {LONGEST_TEXT} characters")
    if len(json.dumps(text)) > LONGEST_ESCAPED:
        raise ValueError(
            f"longer than {LONGEST_ESCAPED} characters with those beyond ASCII escaped"
        )
    try:
        rows = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"no JSON: {error}") from error
    if not isinstance(rows, dict):
        raise ValueError('not an object of fixtures by name, like {"floor": {"kind": "wall", ...}}')
    if len(rows) > MOST_FIXTURES:
        raise ValueError(f"{len(rows)} fixtures, {MOST_FIXTURES} at most")
    found = {}
    for name, row in rows.items():
        if not name:
            raise ValueError("a fixture must have a name, not an empty one")
        try:
            found[name] = _fixture(row)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
    return found


def _fixture(row: object) -> Fixture:
    if not isinstance(row, dict):
        raise ValueError("no object with kind and its numbers")
    kind = KINDS.get(str(row.get("kind")))
    if kind is None:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, not {row.get('kind')!r}")
    known = {field.name: field for field in fields(kind)}
    unknown = row.keys() - known.keys() - {"kind"}
    if unknown:
        raise ValueError(f"{', '.join(sorted(unknown))}: it has {', '.join(known)}")
    missing = [
        name for name, field in known.items() if field.default is MISSING and name not in row
    ]
    if missing:
        raise ValueError(f"{', '.join(missing)} missing")
    make: Callable[..., Fixture] = kind
    return make(**{name: _value(name, row[name]) for name in known if name in row})


_COUNTS: Final = {"orientation": 4, "point": 3, "normal": 3, "lower": 3, "upper": 3, "center": 3}


def _value(name: str, value: Any) -> Any:
    if name == "keep":
        return value
    count = _COUNTS.get(name)
    if count is None:
        return _number(name, value)
    if not isinstance(value, list) or len(value) != count:
        raise ValueError(f"{name} must be {count} numbers, not {value!r}")
    return tuple(_number(name, each) for each in value)


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name} must be a number, not {value!r}")
    if not abs(value) < 1e9:
        raise ValueError(f"{name} must be finite, not {value}")
    return float(value)
