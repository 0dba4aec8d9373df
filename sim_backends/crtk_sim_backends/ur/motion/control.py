"""Who commands the arm, and what all motions have in common."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, Final, NoReturn, Protocol, TypeAlias

from crtk_sim_backends.ur.clock import Clock
from crtk_sim_backends.ur.motion.arm import approach
from crtk_sim_backends.ur.motion.kinematics import (
    Floats,
    Transform,
    compose,
    multiply,
    norm,
    to_transform,
)
from crtk_sim_backends.ur.motion.plant import Plant
from crtk_sim_backends.ur.urscript import Pose, Program, ScriptRuntimeError
from crtk_sim_backends.ur.urscript.arguments import six

Motion: TypeAlias = Generator[None, None, None]

SLOWEST_SHARE: Final = 0.02
"""Of its speed, to which a motion is slowed down where joints cannot follow; less is a singularity."""


WITHIN: Final = 0.999
"""Of the tool's limit, to which a motion is slowed down: what is monitored is the actual speed."""


class Execution(Protocol):
    """One execution of a program.

    Attributes:
        program: what is executed.
    """

    program: Program


class MotionControl:
    """The arm as motions see it: each claims it in every control period in which it commands it.

    Two threads that claim the arm in the same period stop the program, as on the robot; a thread
    that ends or is killed lets go of it at once.

    Args:
        plant: whose arm it is.
        clock: counts the control periods.
        caller: execution and thread that run now.
        protective_stop: stops the robot, with a reason for the error log.
        tool_speed: of the tool at most, m/s.

    Attributes:
        tool_speed: the same.
    """

    def __init__(
        self,
        plant: Plant,
        clock: Clock,
        caller: Callable[[], tuple[Execution, int]],
        protective_stop: Callable[[int], object],
        tool_speed: float,
    ) -> None:
        self.plant = plant
        self.arm = plant.arm
        self.kinematics = plant.kinematics
        self._clock = clock
        self._caller = caller
        self._protective_stop = protective_stop
        self.tool_speed = tool_speed
        self._claimed_tick = -2
        self._owner: object = None

    @property
    def tick(self) -> int:
        """Number of this control period."""
        return self._clock.ticks

    def claim(self) -> None:
        """Take the arm for this period. Raises ScriptRuntimeError when another thread has it."""
        caller = self._caller()
        if caller[0].program.kind == "sec":
            raise ScriptRuntimeError("A secondary program must not move the robot")
        if not self.arm.enabled:
            raise ScriptRuntimeError("The robot is not running: power it on and release the brakes")
        tick = self._clock.ticks
        if self._claimed_tick == tick:
            if self._owner != caller:
                raise ScriptRuntimeError("Another thread is already controlling the robot")
        elif self.plant.coasts or (
            self._claimed_tick < tick - 1 and self.plant.superposition.source is None
        ):
            self.arm.rebase()
        self._claimed_tick = tick
        self._owner = caller

    def release(self, owner: object) -> None:
        """Let another thread command the arm in this period, because `owner` ended."""
        if self._owner == owner and self._claimed_tick == self._clock.ticks:
            self._claimed_tick -= 1

    def hold(self) -> Motion:
        """Hold the arm for one period."""
        self.claim()
        self.arm.command(list(self.arm.plan_q), [0.0] * 6)
        yield

    def halt(self, deceleration: float) -> Motion:
        """Bring the joints to rest; takes no time when they rest."""
        arm, plant = self.arm, self.plant
        while any(arm.plan_qd) or plant.coasts:
            self.claim()
            step = deceleration * arm.time_left
            arm.command_velocity(approach(arm.commanded_qd, (0.0,) * 6, step))
            yield

    def stop_protectively(self, code: int) -> Generator[None, None, NoReturn]:
        """Stop protectively and wait for the end of the program."""
        self._protective_stop(code)
        while True:
            yield

    @property
    def arm_length(self) -> float:
        """Longest distance of the tool from any joint, m."""
        model = self.arm.model
        return sum(map(abs, (*model.a, *model.d, *self.plant.tool[9:])))

    def share(self, qd: Floats) -> float:
        """Share of these joint speeds, at most 1, at which neither a joint nor the tool is too fast."""
        most = max(abs(v) / limit for v, limit in zip(qd, self.arm.model.velocity, strict=True))
        if sum(map(abs, qd)) * self.arm_length > self.tool_speed:
            matrix = self.kinematics.jacobian(self.arm.plan_q, self.plant.tool)
            most = max(most, norm(multiply(matrix, qd)[:3]) / (WITHIN * self.tool_speed))
        return 1.0 / max(1.0, most)

    def target(self, name: str, value: Any) -> Transform:
        """Transform of an argument that is a pose or joint positions."""
        numbers = six(name, value)
        if isinstance(value, Pose):
            return to_transform(numbers)
        return compose(self.kinematics.flange(numbers), self.plant.tool)

    def goal(self, name: str, value: Any, near: Floats) -> list[float] | None:
        """Joint positions of an argument that is a pose or joint positions; None when out of reach.

        Of several solutions, that nearest to `near` counts.
        """
        if not isinstance(value, Pose):
            return six(name, value)
        return self.kinematics.inverse(self.target(name, value), near, self.plant.tool)
