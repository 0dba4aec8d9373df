"""What acts on the simulated transducer: loads by name, chosen by a line of text.

A load is written ``name:option=value,option=value``, options in the order of the class without their
names too: ``sine:2,5,1`` is ``sine:axis=2,amplitude=5,frequency=1``. Several add up, joined by ``+``::

    constant:fz=-20 + sine:axis=2,amplitude=5,frequency=1 + noise:force=0.05
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Final, Protocol, get_type_hints

import numpy as np
from numpy.typing import NDArray

from crtk_sim_backends.faults import unknown

Array = NDArray[np.float64]

GRAVITY: Final = 9.80665
"""m/s²."""


class LoadError(ValueError):
    """A text that describes no load."""


class Load(Protocol):
    """Something that acts on the transducer."""

    def wrench(self, t: Array) -> Array:
        """Return force in N and torque in N·m (n, 6) at times `t` (n,), in s since the start.

        The wrench is in the transducer's frame and about its origin. Times ascend within a call, and the
        last few may be asked for again: a load answers from the time alone.
        """


def _finite(load: Any) -> None:
    for entry in (entry for entry in dataclasses.fields(load) if entry.init):
        value = getattr(load, entry.name)
        if isinstance(value, float) and not math.isfinite(value):
            raise LoadError(f"{entry.name} must be finite, not {value}")


def _axis(load: Any) -> None:
    _finite(load)
    if not 0 <= load.axis <= 5:
        raise LoadError(f"axis must be 0 to 5 (fx, fy, fz, tx, ty, tz), not {load.axis}")


@dataclass(frozen=True)
class Constant:
    """The same all the time: N and N·m."""

    fx: float = 0.0
    fy: float = 0.0
    fz: float = 0.0
    tx: float = 0.0
    ty: float = 0.0
    tz: float = 0.0

    def __post_init__(self) -> None:
        _finite(self)

    def wrench(self, t: Array) -> Array:
        """See `Load`."""
        return np.tile(dataclasses.astuple(self), (t.size, 1))


@dataclass(frozen=True)
class Sine:
    """A sine on one axis: amplitude and offset in N or N·m, frequency in Hz, phase in rad."""

    axis: int = 2
    amplitude: float = 1.0
    frequency: float = 1.0
    offset: float = 0.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        _axis(self)

    def wrench(self, t: Array) -> Array:
        """See `Load`."""
        values = np.zeros((t.size, 6))
        angle = 2.0 * np.pi * self.frequency * t + self.phase
        values[:, self.axis] = self.offset + self.amplitude * np.sin(angle)
        return values


@dataclass(frozen=True)
class Spring:
    """A tool that moves to and fro and touches a spring: ``x = amplitude sin(2 pi frequency t)``.

    The spring begins at `gap` (m) and pushes back with `stiffness` (N/m) and `damping` (N·s/m), never
    pulling. The tip of the tool is `length` (m) above the transducer, so that a force along an axis across
    has a moment.
    """

    axis: int = 2
    stiffness: float = 10_000.0
    amplitude: float = 0.002
    frequency: float = 0.5
    gap: float = 0.0
    damping: float = 0.0
    length: float = 0.0

    def __post_init__(self) -> None:
        _finite(self)
        if not 0 <= self.axis <= 2:
            raise LoadError(f"axis must be 0 to 2 (x, y, z), not {self.axis}")

    def wrench(self, t: Array) -> Array:
        """See `Load`."""
        angle = 2.0 * np.pi * self.frequency * t
        depth = self.amplitude * np.sin(angle) - self.gap
        speed = self.amplitude * 2.0 * np.pi * self.frequency * np.cos(angle)
        push = np.where(depth > 0.0, self.stiffness * depth + self.damping * speed, 0.0)
        values = np.zeros((t.size, 6))
        values[:, self.axis] = -np.maximum(push, 0.0)
        values[:, 3] = -self.length * values[:, 1]
        values[:, 4] = self.length * values[:, 0]
        return values


@dataclass(frozen=True)
class Gravity:
    """The weight of a tool on a sensor that is turned.

    Mass in kg, centre of mass (x, y, z) in m in the sensor's frame. The sensor stands at the rotation
    vector (rx, ry, rz), in rad, in a frame whose z axis points up, and swings about its own `axis` by
    `swing` (rad) at `frequency` (Hz).
    """

    mass: float = 1.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    rx: float = 0.0
    ry: float = 0.0
    rz: float = 0.0
    axis: int = 0
    swing: float = 0.0
    frequency: float = 0.1

    def __post_init__(self) -> None:
        _finite(self)
        if not 0 <= self.axis <= 2:
            raise LoadError(f"axis must be 0 to 2 (x, y, z), not {self.axis}")
        if self.mass < 0.0:
            raise LoadError(f"mass must not be negative, not {self.mass}")

    def wrench(self, t: Array) -> Array:
        """See `Load`."""
        down = np.array([0.0, 0.0, -1.0]) @ rotation(np.array([self.rx, self.ry, self.rz]))
        angle = self.swing * np.sin(2.0 * np.pi * self.frequency * t)
        axis = np.eye(3)[self.axis]
        along = axis * (down @ axis)
        across, aside = down - along, np.cross(axis, down)
        # The sensor turns by the angle, so gravity turns by its opposite in the sensor's frame.
        towards = along + np.outer(np.cos(angle), across) - np.outer(np.sin(angle), aside)
        force = self.mass * GRAVITY * towards
        torque = np.cross(np.array([self.x, self.y, self.z]), force)
        wrench: Array = np.hstack([force, torque])
        return wrench


@dataclass(frozen=True)
class Noise:
    """White noise of the whole signal, standard deviations in N and N·m."""

    force: float = 0.05
    torque: float = 0.001
    seed: int = 0
    _generator: np.random.Generator = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        _finite(self)
        if self.force < 0.0 or self.torque < 0.0:
            raise LoadError("standard deviations must not be negative")
        object.__setattr__(self, "_generator", np.random.default_rng(self.seed))

    def wrench(self, t: Array) -> Array:
        """See `Load`. The noise at one time is another one when it is asked for again."""
        values: Array = self._generator.standard_normal((t.size, 6))
        values *= np.repeat((self.force, self.torque), 3)
        return values


@dataclass(frozen=True)
class Sum:
    """Several loads at once; nothing when there are none."""

    loads: Sequence[Load] = ()

    def wrench(self, t: Array) -> Array:
        """See `Load`."""
        total = np.zeros((t.size, 6))
        for load in self.loads:
            total += load.wrench(t)
        return total


LOADS: Final[dict[str, type | str]] = {
    "none": Sum,
    "constant": Constant,
    "sine": Sine,
    "spring": Spring,
    "gravity": Gravity,
    "noise": Noise,
    "replay": "crtk_sim_backends.netft.replay:Replay",
}
"""Classes of loads by name, or where the class is, for one that is imported when it is asked for.

Each is a dataclass; its fields of type str, int, float and bool are the options.
"""

_JOINED: Final = re.compile(rf"\s*\+\s*(?=(?:{'|'.join(LOADS)})\s*(?::|\+|$))")


def parse_load(text: str) -> Load:
    """Return the load that a text describes (see the module's description); none for an empty one.

    Raises:
        LoadError: naming what is wrong and what is known instead.
    """
    if not text.strip():
        return Sum()
    loads = [_parse_one(part.strip()) for part in _JOINED.split(text)]
    return loads[0] if len(loads) == 1 else Sum(loads)


def rotation(vector: Array) -> Array:
    """Return the matrix (3, 3) of a rotation vector in rad."""
    angle = float(np.linalg.norm(vector))
    if not angle:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Array = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    return matrix


def _parse_one(text: str) -> Load:
    name, _, rest = text.partition(":")
    name = name.strip()
    if name not in LOADS:
        raise LoadError(unknown("load", name, LOADS))
    kind = _class_of(name)
    types = get_type_hints(kind)
    options = [e.name for e in dataclasses.fields(kind) if e.init and types[e.name] in _READ]
    given: dict[str, Any] = {}
    for place, part in enumerate(p for p in rest.split(",") if p.strip()):
        option, equals, value = part.partition("=")
        option = option.strip()
        if not equals:
            if place >= len(options):
                raise LoadError(f"{name}: has {len(options)} options, {', '.join(options)}")
            option, value = options[place], part
        if option not in options:
            raise LoadError(f"{name}: {unknown('option', option, options)}")
        if option in given:
            raise LoadError(f"{name}: {option} is given twice")
        given[option] = _read(name, option, types[option], value.strip())
    missing = [
        e.name
        for e in dataclasses.fields(kind)
        if e.name in options and e.default is dataclasses.MISSING and e.name not in given
    ]
    if missing:
        raise LoadError(f"{name}: needs {', '.join(missing)}")
    try:
        load: Load = kind(**given)
    except LoadError as error:
        raise LoadError(f"{name}: {error}") from error
    return load


def _class_of(name: str) -> type[Any]:
    found = LOADS[name]
    if isinstance(found, str):
        module, _, attribute = found.partition(":")
        found = getattr(import_module(module), attribute)
    assert isinstance(found, type)
    return found


def _as_bool(text: str) -> bool:
    known = {"yes": True, "true": True, "1": True, "no": False, "false": False, "0": False}
    return known[text.lower()]


_READ: Final[Mapping[type, Callable[[str], Any]]] = {
    str: str,
    int: int,
    float: float,
    bool: _as_bool,
}


def _read(name: str, option: str, kind: Any, text: str) -> Any:
    try:
        return _READ[kind](text)
    except (ValueError, KeyError) as error:
        raise LoadError(f"{name}: {option} must be {kind.__name__}, not {text!r}") from error
