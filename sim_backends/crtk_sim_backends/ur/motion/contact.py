"""What the tool touches: flat surfaces that give way like a spring with a damper.

A surface acts on the tool centre point alone; the rest of the arm passes through it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

from crtk_sim_backends.ur.motion.kinematics import Floats, norm

if TYPE_CHECKING:
    from crtk_sim_backends.ur.motion.force_sensor import ForceSensor

CONTACT_FORCE = 5.0  # N, from which the tool is in contact with something

STIFFNESS = 10000.0  # N/m
DAMPING = 100.0  # N.s/m
UP = (0.0, 0.0, 1.0)

_SLIDING = 0.005  # m/s, from which friction has its full force


@dataclass(frozen=True)
class Surface:
    """One flat surface in the base frame.

    Attributes:
        point: any point of it, m.
        normal: direction out of the body, a unit vector.
        stiffness: N/m.
        damping: N.s/m, while the tool moves in; it never pulls.
        friction: coefficient of the force against sliding.
    """

    point: tuple[float, float, float]
    normal: tuple[float, float, float]
    stiffness: float = STIFFNESS
    damping: float = DAMPING
    friction: float = 0.0

    @classmethod
    def make(
        cls,
        point: Sequence[float],
        normal: Sequence[float],
        stiffness: float = STIFFNESS,
        damping: float = DAMPING,
        friction: float = 0.0,
    ) -> Surface:
        """Check the numbers and bring `normal` to unit length.

        Raises:
            ValueError: naming what is wrong.
        """
        for name, vector in (("point", point), ("normal", normal)):
            if len(vector) != 3 or not all(map(isfinite, vector)):
                raise ValueError(f"the {name} of a surface is three numbers, not {vector}")
        size = norm(normal)
        if size < 1e-9:
            raise ValueError("the normal of a surface must not be zero")
        if not 0.0 < stiffness <= 1e6:
            raise ValueError(f"the stiffness of a surface lies in (0, 1e6] N/m, not {stiffness}")
        if not 0.0 <= damping <= 1e5:
            raise ValueError(f"the damping of a surface lies in [0, 1e5] N.s/m, not {damping}")
        if not 0.0 <= friction <= 2.0:
            raise ValueError(f"the friction of a surface lies in [0, 2], not {friction}")
        x, y, z = point
        return cls(
            (x, y, z),
            (normal[0] / size, normal[1] / size, normal[2] / size),
            stiffness,
            damping,
            friction,
        )

    def force(self, position: Floats, velocity: Floats) -> tuple[float, float, float] | None:
        """Force on a tool at `position` with `velocity`, N, base axes; None without contact."""
        nx, ny, nz = self.normal
        px, py, pz = self.point
        depth = (px - position[0]) * nx + (py - position[1]) * ny + (pz - position[2]) * nz
        if depth <= 0.0:
            return None
        vx, vy, vz = velocity[:3]
        out = vx * nx + vy * ny + vz * nz
        press = max(0.0, self.stiffness * depth - self.damping * out)
        fx, fy, fz = press * nx, press * ny, press * nz
        if self.friction:
            vx -= out * nx
            vy -= out * ny
            vz -= out * nz
            drag = self.friction * press / max(_SLIDING, norm((vx, vy, vz)))
            fx -= drag * vx
            fy -= drag * vy
            fz -= drag * vz
        return fx, fy, fz


def parse(text: str) -> list[Surface]:
    """Surfaces of an option such as ``0,0,0.1/0,0,1/20000/100/0.3; 0.6,0,0/-1,0,0``.

    Each is a point, a normal, and, where they are not to be the defaults, stiffness, damping and
    friction, with slashes between them.

    Raises:
        ValueError: naming what is wrong.
    """
    surfaces = []
    for entry in filter(None, (part.strip() for part in text.split(";"))):
        fields = entry.split("/")
        if not 2 <= len(fields) <= 5:
            raise ValueError(f"{entry!r} is not point/normal[/stiffness[/damping[/friction]]]")
        try:
            point, normal = ([float(x) for x in field.split(",")] for field in fields[:2])
            numbers = [float(field) for field in fields[2:]]
        except ValueError as error:
            raise ValueError(f"{entry!r} holds something that is no number") from error
        surfaces.append(Surface.make(point, normal, *numbers))
    return surfaces


class Surroundings:
    """Everything that acts on the tool: a push, and the surfaces that it touches.

    Args:
        sensor: feels it.
        outputs: the process image, which tells where the tool is.
        changed: called when the wrench on the tool has changed.
        surfaces: what the tool can touch from the start.
    """

    def __init__(
        self,
        sensor: ForceSensor,
        outputs: Mapping[str, Any],
        changed: Callable[[], None],
        surfaces: Sequence[Surface] = (),
    ) -> None:
        self._sensor = sensor
        self._outputs = outputs
        self._changed = changed
        self._push: tuple[float, ...] = (0.0,) * 6
        self._surfaces = dict(enumerate(surfaces))
        self._felt = 0  # periods since the sensor felt the present contact first

    @property
    def contact_steps(self) -> int:
        """Periods since the tool was first touched, 0 when it is free."""
        return self._felt + 1 if self._felt else 0

    def push(self, wrench: Sequence[float]) -> None:
        """Push with `wrench` (fx fy fz N, tx ty tz N.m) at the TCP, in the axes of the base."""
        if len(wrench) != 6:
            raise ValueError(f"a wrench has six items, got {len(wrench)}")
        self._push = tuple(float(x) for x in wrench)
        self._apply()

    def place(self, index: int, surface: Surface | None) -> None:
        """Put a surface, by a number of one's own, or take it away (None)."""
        if surface is None:
            self._surfaces.pop(index, None)
        else:
            self._surfaces[index] = surface
        self._apply()

    def act(self) -> None:
        """Act on the tool where it is now, once in a period."""
        if self._surfaces:
            self._apply()
        touched = self._outputs["tcp_force_scalar"] >= CONTACT_FORCE
        self._felt = self._felt + 1 if touched else 0

    def _apply(self) -> None:
        position = self._outputs["actual_TCP_pose"]
        velocity = self._outputs["actual_TCP_speed"]
        wrench = self._push
        for surface in self._surfaces.values():
            force = surface.force(position, velocity)
            if force is not None:
                x, y, z = force
                wrench = (wrench[0] + x, wrench[1] + y, wrench[2] + z, *wrench[3:])
        if wrench != self._sensor.applied:
            self._sensor.applied = wrench
            self._changed()
