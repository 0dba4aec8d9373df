"""One user of a device: sends moves, setpoints and stops, and lets the judges know what was asked for.

`operations.py` has what users do with it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from functools import partial
from typing import Any, Final

import numpy as np

from crtk_drivers.commands import Kind, Space, find
from crtk_drivers.errors import CommandRefused, CrtkError, Reason
from crtk_drivers.front import LocalDevice
from crtk_drivers.motion.move import Move, Outcome
from crtk_drivers.samples import Vector
from crtk_drivers.state import OperatingState, StateCommand
from crtk_drivers.testing.world.promises.subject import Busy, Scene
from crtk_drivers.testing.world.world import World

MOMENT: Final = 0.01
"""s around something important within which a fault may come."""
PATIENCE: Final = 10.0
LOOKS: Final = 0.8
"""s that judges need to see that something moves still."""
SEEN: Final = 0.1
"""s for which a goal counts as reached: the arm may have been held up or moved on since."""
_STOP_TAKES: Final = 0.3
"""s in which a stop is accepted: it waits for nothing."""
_FAR: Final = 8.0
"""Times the longest of the usual moves."""
_SLOWER: Final = "trajectory_j/set_ratio_v"
_WAITS: Final = frozenset({Reason.TRANSITION_RUNNING, Reason.MODE_SWITCH, Reason.STREAM_OWNED})
"""Reasons for which a command is refused that comes too early."""


def attempt(
    world: World, name: str, act: Callable[[], object], is_expected: Callable[[CrtkError], bool]
) -> None:
    """Do something that may be refused, with a reason.

    Args:
        world: where.
        name: for the finding.
        act: does it.
        is_expected: whether an error may come though nothing goes wrong.
    """
    try:
        act()
    except CrtkError as error:
        world.say(f"  {type(error).__name__}: {error}")
        if not (world.wild or is_expected(error)):
            world.find("it fails though nothing is wrong", f"{name}: {error}")
        if not str(error) or (isinstance(error, CommandRefused) and not error.detail):
            world.find("refused without a reason", repr(error))
        time.sleep(world.random.random() * 0.3)


class User:
    """A user of a device, who chooses by the world's generator.

    Args:
        scene: with the driver connected.

    Attributes:
        arm: the device, as this user has it.
        engine: of the driver.
        is_far: whether ROS is between the two.
        random: the generator.
        lower, upper: range of its joints, in rad (m).
        other: a second client of the device.
        has_interfered: whether a service was asked for since the device was ENABLED: it may take its time.
    """

    is_far = False
    stop_takes = _STOP_TAKES

    def __init__(self, scene: Scene) -> None:
        assert scene.arm is not None
        self.scene = scene
        self.arm: Any = scene.arm
        self.engine = scene.arm.engine
        self.random = scene.world.random
        capabilities = self.engine.capabilities
        self.lower = np.array([limit.lower for limit in capabilities.limits])
        self.upper = np.array([limit.upper for limit in capabilities.limits])
        self.other: Any = self.another()
        self.has_interfered = False

    def another(self) -> Any:
        """Return another client of the device."""
        assert self.scene.arm is not None
        return LocalDevice(self.scene.arm._session)  # noqa: SLF001 - a client in the same process

    def leaves(self, client: Any) -> None:
        """Let a client go away, whatever it does."""
        client._client.leave()  # noqa: SLF001

    # Whatever it is

    def attempt(
        self,
        name: str,
        act: Callable[[], object],
        *,
        may_fail: bool = False,
        may_be: Collection[Reason] = (),
    ) -> None:
        """Do something that may be refused, with a reason.

        Args:
            name: for the story.
            act: does it.
            may_fail: it may fail though nothing goes wrong: it is stopped on purpose.
            may_be: for these reasons it may be refused though nothing goes wrong.
        """

        def is_expected(error: CrtkError) -> bool:
            reason = error.reason if isinstance(error, CommandRefused) else None
            if self.is_far and reason is not None:
                return True  # of what was sent before: it is told when the next command is sent
            return may_fail or self.has_interfered or reason in {*_WAITS, *may_be}

        if name != "enable":
            self.scene.world.say(f"{name}, {self.arm.operating_state().state}")
        attempt(self.scene.world, name, act, is_expected)

    def pause(self, most: float) -> None:
        """Do nothing for a while."""
        time.sleep(self.random.random() * most)

    def until_enabled(self) -> None:
        """Enable the device, whatever its state."""
        arm = self.arm
        if not arm.is_enabled():
            arm.wait_for_status(lambda status: status.state != OperatingState.FAULT, 0.5)
            if arm.operating_state().state == OperatingState.PAUSED:
                command = self.random.choice((StateCommand.RESUME, StateCommand.DISABLE))
                arm.state_command(command, PATIENCE)
            if not arm.is_enabled():
                arm.enable(timeout=PATIENCE)
        self.has_interfered &= not arm.is_enabled()

    # Where it is, and where it is to go

    def signed(self, most: float) -> float:
        """Return a number from -`most` to `most`."""
        return most * (2.0 * self.random.random() - 1.0)

    def way(self, most: float) -> Vector:
        """Return a way of the tool, of at most `most` along each axis."""
        return np.array([self.signed(most) for _ in range(3)])

    def measured(self) -> Vector:
        """Return where the joints are measured."""
        found: Vector = self.arm.measured_js().position
        return found

    def set_last(self) -> Vector:
        """Return where the joints were sent last, or where they are if that was no position."""
        found: Vector = self.arm.setpoint_jp(age=0)
        return found if found.size else self.measured()

    def within(self, wanted: Vector) -> Vector:
        """Return what is nearest to a position and well within the range."""
        margin = np.minimum(0.05 * (self.upper - self.lower), self.scene.subject.step)
        return np.clip(wanted, self.lower + margin, self.upper - margin)

    def goal(self) -> Vector:
        """Return where a usual move goes."""
        return self.within(self.measured() + self.signed(self.scene.subject.step))

    # Motion

    def send_move(self, goal: Vector, arm: Any = None) -> Move:
        """Send a move of the joints, of this client or of another one."""
        return self.send("move_jp", goal, arm)

    def send(self, name: str, value: object, arm: Any = None) -> Move:
        """Send a move by its name."""
        scene = self.scene
        with scene.sending(by_tool=find(name).space is Space.CARTESIAN):
            move: Move = getattr(arm or self.arm, name)(value)
            scene.sent(self.asked(move))
        return move

    def asked(self, move: Move) -> Busy:
        """Return what says for how long a move is asked for."""
        return move

    def stream(self, name: str, values: object, arm: Any = None) -> None:
        """Send a setpoint of a stream."""
        command = find(name)
        by_tool = command.space is Space.CARTESIAN and command.kind is not Kind.EFFORT
        with self.scene.sending(silence=self.silence(name), by_tool=by_tool):
            getattr(arm or self.arm, name)(values)

    def silence(self, name: str) -> float:
        """Return the s without a command after which a stream has ended."""
        return self.engine.options.silence(find(name).level)

    def move(self, *, waits: bool, seen: float = SEEN) -> None:
        """Move, and wait until it is there, or not; it was there in the last `seen` s."""
        goal = self.goal()
        move = self.send_move(goal)
        self.pause(0.3)
        if waits:
            self.await_reached(move, goal, seen)

    def await_reached(self, move: Move, goal: Vector | None = None, seen: float = SEEN) -> bool:
        """Wait for the end of a move, and return whether it is there; with its goal, see that it is."""
        scene = self.scene
        if move.wait(PATIENCE):
            if goal is not None:
                self.see_reached(move, goal, seen)
            return True
        if move.outcome is not Outcome.RUNNING:
            text = f"wait() returns False; {move.outcome}"
            scene.world.find("wait contradicts the outcome", text)
        return False

    def see_reached(self, move: Move, goal: Vector, seen: float = SEEN) -> None:
        """See that the joints are, or were in the last `seen` s, where a move has taken them."""
        if not self.was_at(goal, seen):
            text = f"a {move.name} to {goal} is reached, and the joints are at {self.scene.joints}"
            self.scene.world.find("reached too early", text)

    def was_at(self, goal: Vector, seconds: float) -> bool:
        """Return whether the joints were at a goal within the last s."""
        scene = self.scene
        return scene.was_at(goal.tolist(), scene.now - seconds, scene.now, scene.arrival)

    def far_move(self) -> tuple[Move, Vector]:
        """Begin a long move, most often a slow one; return it and its goal."""
        draw, step = self.random, self.scene.subject.step
        goal = self.within(self.measured() + _FAR * step * draw.choice((-1.0, 1.0)))
        slow = _SLOWER in self.arm.crtk_commands and draw.random() < 0.7
        if slow:
            self.arm.trajectory_j.set_ratio_v(0.2)
        try:
            return self.send_move(goal), goal
        finally:
            if slow:
                self.arm.trajectory_j.set_ratio_v(1.0)

    # Stops and states

    def hold(self, arm: Any = None) -> None:
        """Stop, by this client or by another one."""
        self._never_refused("hold", (arm or self.arm).hold)
        self.pause(0.1)

    def stop_anyhow(self) -> None:
        """Stop by one of the commands that do."""
        command = self.random.choice((None, StateCommand.PAUSE, StateCommand.DISABLE))
        self.hold() if command is None else self.state(command)

    def state(self, command: StateCommand, timeout: float | None = None) -> None:
        """Send a state command, and wait for its end or not."""
        if timeout is None:
            timeout = self.random.choice((0.0, PATIENCE))
        send = partial(self.arm.state_command, command, timeout)
        if command is StateCommand.DISABLE:
            self._never_refused(command, send)
        else:
            with self.scene.stopping():
                send()
        self.pause(0.05)

    def _never_refused(self, name: str, send: Callable[[], None]) -> None:
        """Send something that stops, with a fault around it in a wild world; it is never refused."""
        scene, engine = self.scene, self.engine
        world = scene.world
        if world.wild:
            world.troubles.around(MOMENT)
        was_connected, begun = engine.connected, scene.now
        try:
            with scene.stopping():
                send()
            since = max(begun, scene.hindered)
            if name == "hold" and scene.now - since > self.stop_takes:
                world.find("a stop waits", f"hold took {scene.now - since:.3f} s")
        except CommandRefused as refusal:
            if was_connected and engine.connected and scene.closing is None:
                world.find("a stop is refused", f"{name}: {refusal}")
            raise
