"""Defects of simulated joints, for a bench that must find them: what is told of them is not what they do.

Simulators have them as one option, a text such as ``position_noise=1e-3,backlash=0.01,joints=2+3``; ``;`` is
before what other joints have. :func:`read_defects` makes frozen dataclasses of it, whose fields are numbers:
0, or for factors 1, is no defect.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from random import Random
from typing import Any, Final, TypeVar

from crtk_sim_backends.faults import unknown
from crtk_sim_backends.options import ConfigError

_SAME_TIME: Final = 1e-6  # s that two times may be apart and be meant as one
_STANDING: Final = 1e-9  # rad


@dataclass(frozen=True, kw_only=True)
class JointDefects:
    """What is wrong with what joints tell of themselves; SI units.

    Attributes:
        joints: that have defects, by the numbers of the simulator; all if there are none.
        seed: of all that is random.
        position_noise: standard deviation of positions.
        position_line: amplitude of a line in positions, at `line_frequency` Hz.
        position_drift: of positions, rad/s.
        position_jump: by which positions are off once the joint has passed `jump_at` upwards.
        backlash: between motor and joint; what is told stays behind by half of it either way.
        velocity_lag: velocities are those of so long ago, s.
        velocity_scale: factor on velocities.
        effort_sign: -1: efforts have the wrong sign.
        effort_scale: factor on efforts.
        frozen_share: share of what is told that is what was told before.
    """

    joints: tuple[int, ...] = ()
    seed: int = 1
    position_noise: float = 0.0
    position_line: float = 0.0
    line_frequency: float = 50.0
    position_drift: float = 0.0
    position_jump: float = 0.0
    jump_at: float = 0.0
    backlash: float = 0.0
    velocity_lag: float = 0.0
    velocity_scale: float = 1.0
    effort_sign: float = 1.0
    effort_scale: float = 1.0
    frozen_share: float = 0.0


D = TypeVar("D", bound=JointDefects)
K = TypeVar("K")


def read_defects(kind: type[K], text: str) -> tuple[K, ...]:
    """Return the defects that a text describes, an entry for each group (of joints).

    Raises:
        ConfigError: naming what is wrong and what is known instead.
    """
    return tuple(_read_group(kind, group) for group in text.split(";") if group.strip())


def read_one(kind: type[K], text: str) -> K:
    """Return the defects that a text describes of a device that has one group of them.

    Raises:
        ConfigError: as `read_defects`, or it has more groups.
    """
    found = read_defects(kind, text)
    if len(found) > 1:
        raise ConfigError("defects: this device has one group of them, without ';'")
    return found[0] if found else kind()


def defects_of(groups: Iterable[D], joint: int) -> D | None:
    """Return the defects of a joint, those of the first group that it belongs to; None if it has none."""
    return next((group for group in groups if not group.joints or joint in group.joints), None)


def _read_group(kind: type[K], text: str) -> K:
    known = {field.name: field.default for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    given: dict[str, Any] = {}
    for part in text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if name not in known:
            raise ConfigError(f"defects: {unknown('defect', name, known)}")
        given[name] = _read(name, value if equals else "1", known[name])
    try:
        return kind(**given)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _read(name: str, text: str, default: Any) -> Any:
    try:
        if isinstance(default, tuple):
            return tuple(int(number) for number in text.split("+"))
        value = type(default)(text)
    except ValueError as error:
        raise ConfigError(f"defects: {name} takes a number, not {text!r}") from error
    if not math.isfinite(value):
        raise ConfigError(f"defects: {name} takes a number, not {text!r}")
    return value


class Sense:
    """What one joint tells. Pure: its time is given.

    Args:
        defects: of the joint.
        joint: its number, by which joints differ in what is random.
    """

    def __init__(self, defects: JointDefects, joint: int) -> None:
        self._defects = defects
        self._random = Random(f"{defects.seed} {joint}")
        self._past: deque[tuple[float, float]] = deque()
        self._behind: float | None = None
        self._began = 0.0
        self._was_past = False
        self._told: tuple[float, float, float] | None = None

    def tell(self, q: float, v: float, effort: float, now: float) -> tuple[float, float, float]:
        """Return position, velocity and effort as they are told at a time, s."""
        if self._told is not None and self._random.random() < self._defects.frozen_share:
            return self._told
        position, velocity = self.motion(q, v, now)
        self._told = position, velocity, self.effort(effort)
        return self._told

    def motion(self, q: float, v: float, now: float) -> tuple[float, float]:
        """Return position and velocity as they are told at a time, s."""
        defects = self._defects
        if self._behind is None:
            self._behind, self._began, self._was_past = q, now, q > defects.jump_at
        q, v = self._after_backlash(q, v, self._behind)
        jumped = (q > defects.jump_at) - self._was_past
        since = now - self._began
        wave = math.sin(2.0 * math.pi * defects.line_frequency * since)
        position = q + defects.position_jump * jumped + defects.position_line * wave
        position += defects.position_drift * since
        if defects.position_noise:
            position += self._random.gauss(0.0, defects.position_noise)
        return position, defects.velocity_scale * self._before(v, now)

    def effort(self, effort: float) -> float:
        """Return an effort as it is told."""
        return self._defects.effort_sign * self._defects.effort_scale * effort

    def _after_backlash(self, q: float, v: float, behind: float) -> tuple[float, float]:
        half = 0.5 * self._defects.backlash
        if not half:
            return q, v
        self._behind = min(max(behind, q - half), q + half)
        is_carried = abs(self._behind - behind) > _STANDING
        return self._behind, v if is_carried else 0.0

    def _before(self, v: float, now: float) -> float:
        past, since = self._past, now - self._defects.velocity_lag + _SAME_TIME
        past.append((now, v))
        while len(past) > 1 and past[1][0] <= since:
            past.popleft()
        return past[0][1]
