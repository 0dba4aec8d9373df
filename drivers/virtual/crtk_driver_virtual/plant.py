"""The arm that moves: joints with motors, servos, friction and stops, and what the tool runs into.

Pure: no clock and no thread. `Plant.advance` takes elapsed time in fixed substeps. All is in SI units and
in the axes of the arm's base, linear before angular.

Servos follow position and velocity with inverse dynamics and saturate at the effort limits; efforts act on
the rigid-body model, integrated semi-implicitly (velocity first). Friction, walls and stops are implicit: no
stiffness and no damping makes them unstable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

import numpy as np

from crtk_driver_virtual.dynamics import ArmDynamics
from crtk_driver_virtual.models import Arm
from crtk_driver_virtual.servo import JointServo
from crtk_drivers.samples import Array, Pose, Vector, empty

SUBSTEP: Final = 1e-3
"""Seconds of one substep."""
LONGEST_RAMP: Final = 0.05
"""Seconds between two position setpoints up to which they are one stream, joined by straight lines."""
SWEEPS: Final = 10
"""How often contacts that act at the same time are brought to agree."""
OVERSPEED: Final = 2.0
"""Times a joint's velocity limit beyond which its drive lets it go no faster, whatever the effort."""


class Drive(StrEnum):
    """What the motors do."""

    HOLD = "hold"
    POSITION = "position"
    VELOCITY = "velocity"
    EFFORT = "effort"
    WRENCH = "wrench"
    FREE = "free"


@dataclass(frozen=True, slots=True, eq=False)
class Command:
    """What the motors are to do from now on; a new one is a new object.

    `values` are joint positions, velocities or efforts (n,), or the wrench (6,) that the tool exerts.
    """

    drive: Drive
    values: Vector = field(default_factory=empty)


SERVOED: Final = (Drive.HOLD, Drive.POSITION, Drive.VELOCITY)
"""Drives in which the joints follow a reference."""

HOLD: Final = Command(Drive.HOLD)
FREE: Final = Command(Drive.FREE)


@dataclass(frozen=True, slots=True, eq=False)
class Wall:
    """A plane through `point` (3,) m with the unit `normal` (3,) out of it; N/m and N·s/m."""

    point: Vector
    normal: Vector
    stiffness: float
    damping: float


@dataclass(frozen=True, slots=True, eq=False)
class _Contact:
    """Something that pushes in one direction only.

    `row` (n,) turns joint velocities into the velocity away from it; `gap` is how far away it is.
    """

    row: Vector
    gap: float
    stiffness: float = math.inf
    damping: float = 0.0

    def push(self, push: float, velocity: float, mobility: float) -> float:
        """Return the force of a substep, such that it is that of the spring and damper at its end.

        Args:
            push: the force that is counted so far.
            velocity: away from it, as it is at the end with that force.
            mobility: acceleration away from it per force.
        """
        reached = self.gap + SUBSTEP * velocity
        if math.isinf(self.stiffness):
            change = -reached / (SUBSTEP * SUBSTEP * mobility)
        else:
            wanted = -self.stiffness * reached - self.damping * velocity
            per_speed = SUBSTEP * self.stiffness + self.damping
            change = (wanted - push) / (1.0 + SUBSTEP * per_speed * mobility)
        return max(0.0, push + change)


class Plant:
    """One arm with its motors. `command`, `braked`, `hand` may be set from any thread.

    Args:
        arm: the model.
        gravity: acceleration of free fall (3,), in m/s².
        tool: of the tool point in the tip of the chain.
        walls: what the tool point cannot pass.
        cycle: seconds between two setpoints of a stream, at least.
        bandwidth: of the position servos, in Hz.

    Attributes:
        command: what the motors do when the brakes are released.
        braked: the joints stand, and the motors are off.
        gravity_compensation: motors carry the arm's weight beside commanded efforts.
        hand: a wrench (6,) that somebody exerts on the tool.
        position, velocity: (n,) in rad, rad/s (m, m/s).
        effort: (n,) of the motors, in N·m (N).
        wrench: (6,) that the hand and the walls exert on the tool.
        time: of the plant, in s.
    """

    def __init__(
        self,
        arm: Arm,
        *,
        gravity: Sequence[float] = (0.0, 0.0, -9.81),
        tool: Pose | None = None,
        walls: Sequence[Wall] = (),
        cycle: float = 2e-3,
        bandwidth: float = 20.0,
    ) -> None:
        self.command = HOLD
        self.braked = True
        self.gravity_compensation = True
        self.hand = np.zeros(6)
        self.position = np.array(arm.start)
        self.velocity = np.zeros(arm.start.size)
        self.effort = np.zeros(arm.start.size)
        self.wrench = np.zeros(6)
        self.time = 0.0
        # Friction of the velocity at the end of a substep is that of its beginning plus this inertia.
        extra_inertia = arm.rotor_inertia + SUBSTEP * arm.damping
        self.dynamics = ArmDynamics(arm, gravity, extra_inertia, tool)
        self._damping = arm.damping
        self._lower, self._upper, fastest, self._strongest = (
            np.array([getattr(limit, name) for limit in arm.limits])
            for name in ("lower", "upper", "velocity", "effort")
        )
        self._overspeed = OVERSPEED * fastest
        self._servos = [JointServo(limit, bandwidth, SUBSTEP) for limit in arm.limits]
        self._walls = tuple(walls)
        self._cycle = cycle
        self._left_over = 0.0
        self._following: Command | None = None
        self._set_at = 0.0
        self._looked_from: Vector | None = None
        self._look()

    @property
    def jacobian(self) -> Array:
        """(6, n) at the tool point."""
        return self._look()[1]

    @property
    def is_held(self) -> bool:
        """Whether it was told to hold and has slowed down."""
        if self.braked:
            return True
        return self._following is HOLD and all(servo.is_at_rest for servo in self._servos)

    def advance(self, elapsed: float) -> None:
        """Go on by `elapsed` seconds; what is less than a substep counts the next time."""
        self._left_over += elapsed
        while self._left_over >= SUBSTEP:
            self._left_over -= SUBSTEP
            self.step()

    def step(self) -> None:
        """Go on by one substep."""
        self.time += SUBSTEP
        if self.braked:
            self._stand()
            return
        command = self.command
        if command is not self._following:
            self._begin(command)
        q, v = self.position, self.velocity
        if command.drive in SERVOED:
            change = self._servo_acceleration(command, q.tolist(), v.tolist())
            asked = self.dynamics.effort(q, v, change) + self._friction(v)
        else:
            change, asked = None, self._motor_effort(command, q)
        self.effort = effort = np.minimum(np.maximum(asked, -self._strongest), self._strongest)
        if change is None or self.hand.any() or (effort != asked).any():
            load = effort - self._friction(v) + self.jacobian.T @ self.hand
            change = self.dynamics.acceleration(q, v, load)
        moved, pushes = self._after_contacts(q, v + SUBSTEP * change)
        self.velocity = np.minimum(np.maximum(moved, -self._overspeed), self._overspeed)
        self.position = np.minimum(
            np.maximum(q + SUBSTEP * self.velocity, self._lower), self._upper
        )
        self._sense(pushes)

    def _stand(self) -> None:
        self._following = None
        self.velocity = np.zeros_like(self.velocity)
        self.effort = np.zeros_like(self.effort)
        pushes = np.zeros(3)
        for wall, contact in self._touched():
            pushes += contact.push(0.0, 0.0, 0.0) * wall.normal
        self._sense(pushes)

    def _sense(self, pushes: Vector) -> None:
        self.wrench = self.hand.copy()
        self.wrench[:3] += pushes

    def _look(self) -> tuple[Vector, Array]:
        """Return the tool point (3,) and the Jacobian there."""
        if self._looked_from is not self.position:
            self._tool = self.dynamics.tool(self.position)
            self._looked_from = self.position
        return self._tool

    # ---------------------------------------------------------------------------------------- motors

    def _begin(self, command: Command) -> None:
        """Take a new command. The servos go on from what they follow, or from where the joints are."""
        before = None if self._following is None else self._following.drive
        if before not in SERVOED:
            joints = zip(self._servos, self.position.tolist(), self.velocity.tolist(), strict=True)
            for servo, q, v in joints:
                servo.start(q, v)
        if command.drive is Drive.POSITION:
            since = self.time - self._set_at if before is Drive.POSITION else math.inf
            self._go_to(command.values.tolist(), since)
        self._following = command

    def _go_to(self, goals: Sequence[float], since: float) -> None:
        """Take a position setpoint, `since` seconds after the last one."""
        targets = list(zip(self._servos, goals, strict=True))
        duration = max(since, self._cycle)
        if since <= LONGEST_RAMP and all(
            servo.can_reach(goal, duration) for servo, goal in targets
        ):
            for servo, goal in targets:
                servo.ramp_to(goal, duration)
        else:
            for servo, goal in targets:
                servo.jump_to(goal)
        self._set_at = self.time

    def _friction(self, v: Vector) -> Vector:
        return self._damping * v

    def _motor_effort(self, command: Command, q: Vector) -> Vector:
        """Return what motors are asked for that follow no reference."""
        weight = self.dynamics.weight(q)
        if command.drive is Drive.FREE:
            return weight
        is_wrench = command.drive is Drive.WRENCH
        effort = self.jacobian.T @ command.values if is_wrench else command.values
        return effort + weight if self.gravity_compensation else effort

    def _servo_acceleration(
        self, command: Command, q: Sequence[float], v: Sequence[float]
    ) -> Vector:
        if command.drive is Drive.POSITION:
            found = [s.follow_ramp(q[i], v[i]) for i, s in enumerate(self._servos)]
        else:
            is_velocity = command.drive is Drive.VELOCITY
            goal = command.values.tolist() if is_velocity else [0.0] * len(q)
            found = [s.follow_velocity(goal[i], q[i], v[i]) for i, s in enumerate(self._servos)]
        return np.array(found)

    # -------------------------------------------------------------------------------------- contacts

    def _after_contacts(self, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """Return joint velocities and the force on the tool (3,) after stops and walls pushed back.

        Args:
            q: positions at the beginning of the substep.
            v: velocities at its end, without them.
        """
        force = np.zeros(3)
        walls = tuple(self._touched(v)) if self._walls else ()
        ahead = q + SUBSTEP * v
        beyond = (ahead < self._lower) | (ahead > self._upper)
        if not walls and not beyond.any():
            return v, force
        contacts = [contact for _, contact in walls]
        contacts.extend(self._stops(q, np.flatnonzero(beyond).tolist()))
        v, pushes = _pushed(contacts, v, self.dynamics.mobility(q))
        for (wall, _), push in zip(walls, pushes, strict=False):
            force += push * wall.normal
        return v, force

    def _touched(self, v: Vector | None = None) -> Iterator[tuple[Wall, _Contact]]:
        """Yield the walls that the tool point is in, or will be with joint velocities `v`."""
        for wall in self._walls:
            point, jacobian = self._look()
            row = wall.normal @ jacobian[:3]
            gap = float(wall.normal @ (point - wall.point))
            if gap + (0.0 if v is None else SUBSTEP * float(row @ v)) < 0.0:
                yield wall, _Contact(row, gap, wall.stiffness, wall.damping)

    def _stops(self, q: Vector, joints: Sequence[int]) -> Iterator[_Contact]:
        for joint in joints:
            row = np.zeros(q.size)
            is_lower = 2.0 * q[joint] < self._lower[joint] + self._upper[joint]
            row[joint] = 1.0 if is_lower else -1.0
            gap = q[joint] - self._lower[joint] if is_lower else self._upper[joint] - q[joint]
            yield _Contact(row, float(gap))


def _pushed(
    contacts: Sequence[_Contact], v: Vector, mobility: Array
) -> tuple[Vector, Sequence[float]]:
    """Return the joint velocities with the forces of all contacts, and these (projected Gauss-Seidel)."""
    eased = [mobility @ contact.row for contact in contacts]
    pushes = [0.0] * len(contacts)
    for _ in range(SWEEPS if len(contacts) > 1 else 1):
        for i, contact in enumerate(contacts):
            per_force = float(contact.row @ eased[i])
            push = contact.push(pushes[i], float(contact.row @ v), per_force)
            v = v + SUBSTEP * (push - pushes[i]) * eased[i]
            pushes[i] = push
    return v, pushes
