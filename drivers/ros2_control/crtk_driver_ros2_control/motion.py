"""What the controllers of a robot are made to do: modes and their switches, moves, stops, who holds.

A switch is a procedure that the I/O thread steps: it asks the controller manager, and believes what the list
of controllers shows. Setpoints that come meanwhile wait, the newest alone.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Final, Protocol

import numpy as np

from crtk_driver_ros2_control.arm import Arm
from crtk_driver_ros2_control.asking import Asked, Delivery, Following
from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_driver_ros2_control.controllers import (
    FORWARD,
    Controller,
    Role,
    Switch,
    joints_of,
    switch_to,
    ways_of,
)
from crtk_driver_ros2_control.joint_states import Measured
from crtk_driver_ros2_control.outgoing import POSITIONS, Outgoing
from crtk_driver_ros2_control.supervision import Supervision
from crtk_drivers.device import Condition, Goal, MoveProgress, Setpoint, Steps
from crtk_drivers.errors import (
    CrtkError,
    DeviceError,
    DeviceFault,
    MotionAborted,
    TransitionFailed,
    raise_first,
)
from crtk_drivers.samples import Vector, vector
from crtk_drivers.state import OperatingState

SETTLED: Final = 0.02
"""rad (m) that joints that stand may be from the held position; further away that is what is held instead."""
STANDS: Final = 0.02
"""rad/s (m/s) below which a joint stands, at the least."""
STILL: Final = 0.03
"""Share of its velocity limit below which a joint stands: noise."""
SHORTEST: Final = 0.1
"""Seconds that a goal of the trajectory controller takes at the least."""
ARRIVAL: Final = 0.5
"""Seconds for which a command is waited for until all subscribers have it: dead ones never do."""
KNOWN: Final = 0.9
"""Share of `sample_timeout` for which a joint state says where the joints are."""


class GoalWire(Protocol):
    """What sends goals, and tells what has arrived; see `..foreign.node.ForeignNode`."""

    def follow(self, goal: Following) -> None:
        """Send a goal to the trajectory controller."""

    def cancel(self, goal: Following) -> None:
        """End a goal."""

    def delivery(self, controller: str) -> Asked[Delivery]:
        """Ask who gets what is sent to a controller."""


class Motion:
    """The controllers of one robot, as they are used. For the I/O thread; `stop` is for any.

    Args:
        config: of the robot.
        arm: its joints.
        roles: names of our controllers.
        outgoing: its commands.
        here: returns the newest joint state, None before the first.
        where: of the robot, for messages.

    Attributes:
        role: of the controller that is to be active; None if none of ours is.
        switches: how many were carried out.
    """

    def __init__(
        self,
        config: Ros2ControlConfig,
        arm: Arm,
        roles: Mapping[Role, str],
        outgoing: Outgoing,
        here: Callable[[], Measured | None],
        where: str,
    ) -> None:
        self._config = config
        self._joints = arm.joints
        self._acceleration = np.array([limit.acceleration for limit in arm.limits])
        self._speed = np.array([limit.velocity for limit in arm.limits])
        self._still = np.maximum(STANDS, STILL * self._speed)
        self._roles = roles
        self._ways = ways_of(roles)
        self._outgoing = outgoing
        self._here = here
        self._where = where
        self._node: GoalWire | None = None
        self._supervision: Supervision | None = None
        self._stop_asked = threading.Event()
        self.switches = 0
        self._has_left_goals = False
        self._begin_anew()

    def _begin_anew(self) -> None:
        self.role: Role | None = None
        self._expected_since = 0.0
        self._change: Steps | None = None
        self._waiting: Setpoint | None = None
        self._goal: Following | None = None
        self._goals: list[Following] = []
        self._wanted: Goal | None = None
        self._trouble: Condition | None = None
        self._newest: Measured | None = None
        self._before: Measured | None = None
        self._settled: tuple[Role, Vector] | None = None
        self._stop_asked.clear()

    def connect(self, node: GoalWire, supervision: Supervision) -> None:
        """Begin, of a robot of which nothing is known."""
        self._has_left_goals |= not all(goal.has_ended for goal in self._goals)
        self._begin_anew()
        self._outgoing.begin_anew()
        self._node, self._supervision = node, supervision
        if self._has_left_goals:
            self._change = self._end_goals()

    def _end_goals(self) -> Steps:
        """End what the connection before could not: the controller goes on with it by itself."""
        yield from self._connected.end_goals()
        self._has_left_goals = False

    def disconnect(self) -> None:
        """Ask for nothing any more."""
        if self._change is not None:
            self._change.close()
            self._change = None
        self._node = self._supervision = None

    @property
    def _connected(self) -> Supervision:
        assert self._supervision is not None
        return self._supervision

    @property
    def condition(self) -> Condition:
        """What controllers and hardware allow, as they were told of last."""
        supervision = self._supervision
        if supervision is None:
            return Condition()
        if self._trouble is not None:
            return self._trouble
        if supervision.silence:
            return Condition(OperatingState.FAULT, supervision.silence)
        lost = supervision.lost_hardware()
        if lost:
            return Condition(OperatingState.FAULT, lost)
        if self.role is None or self._change is not None:
            return Condition()
        if supervision.listed_at < self._expected_since:
            return Condition()
        return self._of_controllers(supervision)

    def _of_controllers(self, supervision: Supervision) -> Condition:
        """Return what follows from the hardware and from the controller that should be active."""
        assert self.role is not None
        broken = supervision.broken_hardware()
        if broken:
            return Condition(OperatingState.FAULT, broken)
        name, listed = self._roles[self.role], supervision.controllers or {}
        if name not in listed:
            return Condition(OperatingState.FAULT, f"controller {name} is gone")
        others = [
            other.name
            for other in listed.values()
            if other.name != name and joints_of(other.claimed) & set(self._joints)
        ]
        if supervision.is_active(name):
            if others:
                return Condition(OperatingState.PAUSED, f"{', '.join(others)} has the joints, too")
            return Condition()
        state = f"{name} is {listed[name].state}"
        if others:
            return Condition(OperatingState.PAUSED, f"{state}: {', '.join(others)} has the joints")
        return Condition(OperatingState.FAULT, f"{state}, and nobody holds the joints")

    def follow(self, setpoint: Setpoint) -> None:
        """Send it to the controller of its mode; switch to that one first, where another one is active."""
        role = self._ways[setpoint.mode]
        self._stop_asked.clear()
        self._wanted = None
        if self._change is None and role is self.role and self._waiting is None:
            self._outgoing.follow(role, setpoint.values)
            return
        self._waiting = setpoint
        if self._change is None:
            self._begin(self._follow_with(role))

    def _follow_with(self, role: Role) -> Steps:
        yield from self._activate(role)
        waiting, self._waiting = self._waiting, None
        if waiting is None or self._stop_asked.is_set():
            return
        if self._ways[waiting.mode] is role:
            here = self._here()
            assert here is not None
            self._outgoing.follow(role, waiting.values, here.state.position)

    def move(self, goal: Goal) -> None:
        """Have the trajectory controller go there, in a time within the limits of all joints."""
        self._stop_asked.clear()
        self._waiting, self._goal, self._wanted = None, None, goal
        if self._change is None:
            self._begin(self._follow_goal())

    def _follow_goal(self) -> Steps:
        yield from self._activate(Role.TRAJECTORY)
        wanted, self._wanted = self._wanted, None
        if wanted is None:
            return
        assert wanted.joints is not None
        node = self._node
        assert node is not None
        self._outgoing.forget()
        self._goal = Following(self._joints, wanted.joints, self._time_of(wanted))
        self._goals = [*(goal for goal in self._goals if not goal.has_ended), self._goal]
        node.follow(self._goal)

    def _time_of(self, goal: Goal) -> float:
        """Return the seconds in which a cubic way from here to a goal stays within the limits."""
        here = self._here()
        assert here is not None
        assert goal.joints is not None
        way = np.abs(goal.joints - here.state.position)
        speed, ratios = here.state.velocity, goal.ratios
        moving = np.abs(speed) if speed.size else np.zeros_like(way)
        rate = ratios.acceleration * self._acceleration
        by_velocity = 1.5 * way / (ratios.velocity * self._speed)
        by_acceleration = np.sqrt(6.0 * way / rate)
        return float(max(SHORTEST, *by_velocity, *by_acceleration, *(4.0 * moving / rate)))

    def progress(self) -> MoveProgress:
        """Say where the goal stands that was sent last.

        Raises:
            MotionAborted: the controller ended it, and why.
        """
        goal = self._goal
        if self._wanted is not None or self._change is not None:
            return MoveProgress.RUNNING
        if goal is None:
            return MoveProgress.FAILED
        if not goal.has_ended:
            return MoveProgress.RUNNING
        if goal.succeeded:
            return MoveProgress.DONE
        raise MotionAborted(
            f"{self._roles[Role.TRAJECTORY]} ended the move: {goal.text or 'no reason given'}",
            where=self._where,
            remedy="Look at its tolerances, and at what holds the joints.",
        )

    def stop(self) -> None:
        """Come to rest and hold. From any thread."""
        self._stop_asked.set()
        node = self._node
        for goal in self._goals:
            if not goal.has_ended and node is not None:
                node.cancel(goal)
        self._outgoing.stop()

    @property
    def has_stopped(self) -> bool:
        """Whether what was asked of the controllers is to hold, as far as they have answered."""
        ended = all(goal.has_ended for goal in self._goals)
        is_sent = self._outgoing.is_at_rest and self._change is None
        goes_on = self.role is Role.VELOCITY and not self._stands  # zeros may have been lost
        return ended and is_sent and self._holds and not goes_on

    @property
    def takes_setpoints(self) -> bool:
        """Not before it has stopped, and stands."""
        return not self._stop_asked.is_set() or (self.has_stopped and self._stands)

    @property
    def pace(self) -> float:
        """While controllers are switched, nothing of ours is carried out."""
        return 1.0 if self._change is None else 0.0

    @property
    def _stands(self) -> bool:
        here = self._here()
        if here is None:
            return False
        velocity = here.state.velocity if here.state.velocity.size else self._speed_of(here)
        return bool((np.abs(velocity) < self._still).all())

    def _speed_of(self, here: Measured) -> Vector:
        """Return the velocities (n,) of joints that do not tell them, by the joint state before."""
        before = self._before
        if before is None or not before.acquired < here.acquired:
            return vector(np.full_like(here.state.position, np.inf))
        elapsed = here.acquired - before.acquired
        return vector((here.state.position - before.state.position) / elapsed)

    @property
    def _holds(self) -> bool:
        """Whether what was stopped is held: efforts of zero hold nothing where another controller can."""
        return not (self.role is Role.EFFORT and self._holder() is not None)

    def _holder(self) -> Role | None:
        """Return whose controller holds a position, if any does."""
        for role in (Role.POSITION, Role.TRAJECTORY):
            if role in self._roles:
                return role
        return None

    def _obey_stop(self) -> None:
        """What was waiting is not begun after a stop; efforts become a position that is held."""
        if not self._stop_asked.is_set():
            return
        self._waiting = self._wanted = None
        holder = self._holder()
        is_known = self._age() < KNOWN * self._config.sample_timeout
        if self.role is Role.EFFORT and holder is not None and self._change is None and is_known:
            self._begin(self._activate(holder))

    def _age(self) -> float:
        """Return how old (s) the newest joint state is: what is held must not be where joints were."""
        here = self._here()
        return math.inf if here is None else time.monotonic() - here.acquired

    def settle(self, measured: Measured) -> None:
        """Hold where the joints are, once they stand far from what they were told to hold: something is in
        their way. Once for each stop: joints that sag below whatever they are to hold would creep down."""
        self._settle(measured)
        self._newest, self._before = measured, self._newest

    def _settle(self, measured: Measured) -> None:
        held = self._outgoing.held
        is_held = held is not None and held[0] is self.role and self.role in POSITIONS
        if held is None or not is_held or held is self._settled or not self._stop_asked.is_set():
            return
        away = np.abs(held[1] - measured.state.position).max()
        if self._outgoing.is_at_rest and self._stands and away > SETTLED:
            self._outgoing.hold_at(held[0], measured.state.position)
            self._settled = self._outgoing.held

    # ------------------------------------------------------------------------------------- transitions

    def enable(self) -> Steps:
        """Hardware active, then the controller that holds; the setpoint is where the joints are.

        Raises:
            TransitionFailed, DeviceFault: what is in the way.
        """
        supervision = self._connected
        self._trouble = None
        while self._change is not None:
            yield
        self._stop_asked.clear()
        yield from supervision.bring_hardware("active")
        yield from self._checked(supervision)
        self._outgoing.orders = yield from supervision.orders()
        yield from self._activate(self._first_role())

    def _first_role(self) -> Role:
        return self._holder() or next(iter(self._roles))

    def disable(self) -> Steps:
        """Our controllers become inactive, and the hardware too if it is configured so."""
        supervision = self._connected
        if self._change is not None:
            self._change.close()
            self._change = None
        self.role = None
        self._trouble = None
        yield from supervision.listed()
        ours = tuple(name for name in self._roles.values() if supervision.is_active(name))
        yield from supervision.switch(Switch((), ours))
        if self._config.on_disable == "hardware":
            yield from supervision.bring_hardware("inactive")

    def obstacles(self) -> Iterator[DeviceError]:
        """Yield what `enable` fails on now, by what the controller manager has listed last."""
        supervision = self._connected
        if supervision.components is not None:
            yield from supervision.without_hardware(supervision.components)
        listed = supervision.controllers
        if listed is None:
            return
        missing = tuple(self._missing(supervision, listed))
        yield from missing or self._of_activation(self._first_role(), listed)

    def _of_activation(self, role: Role, listed: Mapping[str, Controller]) -> Iterator[DeviceError]:
        """Yield why the controller of a role cannot have the joints."""
        name = self._roles[role]
        if listed[name].state not in ("active", "inactive"):
            yield DeviceFault(
                f"{name} is {listed[name].state}",
                where=self._where,
                remedy="Configure it: ros2 control set_controller_state, or the spawner.",
            )
        _, foreign = switch_to(name, listed, self._roles.values(), self._joints)
        if foreign and not self._config.take_over:
            yield TransitionFailed(
                f"{', '.join(foreign)} has the joints",
                where=self._where,
                remedy="Deactivate it, or configure take_over.",
            )

    def _activate(self, role: Role) -> Steps:
        """Make the controller of a role the one that has the joints, holding where they are."""
        supervision = self._connected
        name = self._roles[role]
        listed = yield from self._checked(supervision)
        raise_first(self._of_activation(role, listed))
        switch, _ = switch_to(name, listed, self._roles.values(), self._joints)
        if not switch.is_empty:
            if role in FORWARD:
                yield from self._prepare(role)
            yield from supervision.switch(switch)
            self.switches += 1
            yield from self._seen_active(supervision, name)
        self.role, self._expected_since = role, time.monotonic()
        self._seed(role)

    def _prepare(self, role: Role) -> Steps:
        """Have a forward controller get what it is to hold before it is activated: some begin with the last
        command that they got.

        Raises:
            TransitionFailed: it does not subscribe to commands.
        """
        name = self._roles[role]
        if not (
            yield from self._seen(
                lambda found: found.listeners > 0, name, self._config.service_timeout
            )
        ):
            raise TransitionFailed(
                f"{name} does not listen to its commands",
                where=self._where,
                remedy="Is it a forward controller, which subscribes to commands?",
            )
        self._seed(role)
        while not self._outgoing.is_at_rest:
            yield
        yield from self._seen(lambda found: found.has_arrived, name, ARRIVAL)

    def _seen(
        self, wanted: Callable[[Delivery], bool], controller: str, seconds: float
    ) -> Generator[None, None, bool]:
        """Look for so many seconds at who gets what is sent; return whether that came to be as wanted."""
        node, deadline = self._node, time.monotonic() + seconds
        assert node is not None
        asked = node.delivery(controller)
        while time.monotonic() < deadline:
            if asked.answer is not None:
                if wanted(asked.answer):
                    return True
                asked = node.delivery(controller)
            yield
        return False

    def _checked(self, supervision: Supervision) -> Generator[None, None, Mapping[str, Controller]]:
        """Return the controllers, once all of ours are among them and suit their roles."""
        listed = yield from supervision.listed()
        raise_first(self._missing(supervision, listed))
        return listed

    def _missing(
        self, supervision: Supervision, listed: Mapping[str, Controller]
    ) -> Iterator[DeviceError]:
        wrong = supervision.check(listed)
        if wrong:
            yield DeviceFault(wrong, where=self._where, remedy="Load it again, then enable.")

    def _seen_active(self, supervision: Supervision, name: str) -> Steps:
        """Believe a switch when the list shows it."""
        deadline = time.monotonic() + self._config.service_timeout
        while True:
            listed: Mapping[str, Controller] = yield from supervision.listed()
            if name in listed and supervision.is_active(name):
                return
            if time.monotonic() > deadline:
                state = listed[name].state if name in listed else "gone"
                raise DeviceFault(
                    f"{name} was to become active, and is {state}",
                    where=self._where,
                    remedy="The log of ros2_control_node says why.",
                )
            yield

    def _seed(self, role: Role) -> None:
        """Let a forward controller hold, before it is active and after: some keep an old command, some drop
        what came before."""
        here = self._here()
        if here is None or self._age() > self._config.sample_timeout:
            raise TransitionFailed(
                "where the joints are is not known",
                where=self._config.joint_states,
                remedy="Enable again when joint states come.",
            )
        if role is Role.POSITION:
            self._outgoing.hold_at(role, here.state.position)
        elif role in FORWARD:
            self._outgoing.hold_at(role, vector(np.zeros_like(here.state.position)))
        else:
            self._outgoing.forget()

    def _begin(self, change: Steps) -> None:
        self._change = change
        self._step_change()

    def step(self) -> None:
        """Go on with what a setpoint, a move or a stop has begun. Once a cycle."""
        self._obey_stop()
        self._step_change()

    def _step_change(self) -> None:
        """Go on with a switch that a setpoint, a move or a stop has begun."""
        change: Steps | None = self._change
        if change is None:
            return
        try:
            next(change)
        except StopIteration:
            self._change = None
        except CrtkError as error:
            self._change = None
            self._waiting = self._wanted = None
            self._trouble = Condition(OperatingState.FAULT, error.statement)
