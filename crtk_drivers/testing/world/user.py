"""What a user does with a device, at random: streams, moves, state commands, a second client, the end.

Each of the three scenarios takes a world and a subject. Wrap one into a function of the world alone, at the
top level of a file, and it can be run with any seed.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from crtk_drivers.commands import find
from crtk_drivers.errors import CommandRefused, CrtkError, DeviceError, Reason
from crtk_drivers.front import LocalDevice
from crtk_drivers.motion.move import Move
from crtk_drivers.samples import Vector
from crtk_drivers.state import OperatingState, StateCommand
from crtk_drivers.testing.world.judges import judge
from crtk_drivers.testing.world.kernel import NS
from crtk_drivers.testing.world.subject import Scene, Setting, Subject
from crtk_drivers.testing.world.world import World

MOMENT: Final = 0.01
"""s around something important within which a fault may come."""
_CYCLE: Final = 0.008
_PATIENCE: Final = 10.0
_SEEN: Final = 0.1
"""s for which a goal counts as reached: the arm may have been held up or moved on since."""
_AFTERWARDS: Final = 0.5
_AFTER_DEATH: Final = 4.0
_STANDS_STILL: Final = 2.0
"""s for which a simulator's process is stopped: longer than any driver waits for a sample."""
_BLOCKED: Final = 0.5
"""s before a death within which the network may be blocked."""
_LONG: Final = ("far move", "long stream")
"""What a driver may be killed in."""
_FREED: Final = 2.5
"""s after a death within which it is free again: later than the devices declare for a stop, too."""
_STOP_TAKES: Final = 0.3
"""s in which a stop is accepted: it waits for nothing."""
_JUMP: Final = 0.6
"""s at full speed that a jump is long."""
_FAR: Final = 8.0
"""Times the longest of the usual moves."""
_SLOWER: Final = "trajectory_j/set_ratio_v"
_LOOKS: Final = 0.8
"""s that judges need to see that something moves still."""
_MAY_FAIL: Final = ("second client", "early move", "stop on the way")
"""What is stopped on purpose."""
_WAITS: Final = (Reason.TRANSITION_RUNNING, Reason.MODE_SWITCH, Reason.STREAM_OWNED)
"""Reasons for which a command is refused that comes too early."""


def use(world: World, subject: Subject, *, operations: int = 25, faults: int = 10) -> None:
    """Use a device in any way for some seconds, and close it.

    Args:
        world, subject: where and what.
        operations: how many things the user does.
        faults: how many come meanwhile, at most.
    """

    def work(scene: Scene) -> None:
        # Without bad weather the wall clock alone is set, and nothing may depend on that.
        kinds = () if world.wild else ("step clock",)
        world.troubles.storm(0.05, 0.25 * operations, faults, kinds)
        User(scene).work(operations)
        close(scene)

    _play(world, subject, work)


def farewell(world: World, subject: Subject) -> None:
    """Let a fault and `close` come within milliseconds of each other, in a move."""

    def work(scene: Scene) -> None:
        user = User(scene)
        user.attempt("enable", user.until_enabled)
        if world.wild:
            world.troubles.around(0.2, chance=1.0)
        user.pause(0.1)
        user.attempt("move", lambda: user.move(waits=False))
        user.pause(world.random.choice((0.03, 0.1, 0.8)))
        close(scene)

    _play(world, subject, work)


def die(world: World, subject: Subject) -> None:
    """Kill the driver's process while it works, or let its machine vanish; then only the device can stop."""
    silently = world.random.random() < 0.5

    def work(scene: Scene) -> None:
        driver = world.kernel.process

        def kill() -> None:
            scene.died = scene.now
            world.say("the driver's machine vanishes" if silently else "the driver is killed")
            world.kernel.end_process(driver, -9, silently=silently)

        user = User(scene)
        is_cut = world.wild and world.random.random() < 0.5
        begins = world.random.choice(_LONG if is_cut else ("", *_LONG))
        if begins:
            user.attempt("enable", user.until_enabled)
        moment = 0.2 + 2.0 * world.random.random()
        world.kernel.after(moment, kill)
        if is_cut:  # what it sends meanwhile is delivered when it is gone
            before = _BLOCKED * world.random.random()
            world.troubles.block(max(0.0, moment - before), before + _FREED * world.random.random())
        if begins == "far move":
            user.attempt("far move", user.far_move)
            time.sleep(_PATIENCE)
        elif begins:
            user.attempt("long stream", user.long_stream)
        user.work(1000)

    _play(world, subject, work)
    time.sleep(_AFTER_DEATH)


def still(world: World, subject: Subject) -> None:
    """Let the simulator's process stand still while the device is ENABLED, and close."""

    def work(scene: Scene) -> None:
        user = User(scene)
        user.attempt("enable", user.until_enabled)
        for process in scene.simulators:
            world.kernel.freeze(process, _STANDS_STILL)
        time.sleep(_STANDS_STILL)
        close(scene)

    _play(world, subject, work)


def _play(world: World, subject: Subject, work: Callable[[Scene], None]) -> None:
    """Start the simulator, and let a driver in a process of its own be worked with, under judges."""
    scene = Scene(world, subject)
    judge(scene)

    def drive() -> None:
        scene.driver = world.kernel.process
        try:
            scene.connect()
        except CrtkError as error:
            world.say(f"no connection: {error}")
        else:
            work(scene)

    world.join(world.start("driver", drive))


def close(scene: Setting) -> None:
    """Close the driver, and go on looking for a while."""
    world = scene.world
    assert scene.arm is not None
    world.say(f"close, {scene.arm.operating_state().state}")
    if world.wild:
        world.troubles.around(MOMENT)
    scene.closing = scene.now
    try:
        scene.arm.close()
    except DeviceError as error:
        world.say(f"closed with {type(error).__name__}: {error}")
        if not world.wild:
            world.find("it fails though nothing is wrong", f"close: {error}")
    else:
        scene.closed = scene.now
        world.say("closed")
    time.sleep(_AFTERWARDS)
    if scene.closed is not None:
        # `close` waits for a bounded time. A thread that stood still longer ends once it runs again.
        while scene.now < _ran_again(scene) + _AFTERWARDS:
            time.sleep(_AFTERWARDS)
        _find_leaks(scene)


def _ran_again(scene: Setting) -> float:
    """Return when the last thread that the world kept from running in the driver may run again (s)."""
    driver = scene.driver
    assert driver is not None
    held = [driver.frozen_until]
    held += [
        task.frozen_until
        for task in scene.world.kernel.tasks
        if task.process is driver and not task.ended and task is not driver.main
    ]
    return max(held) / NS


def _find_leaks(scene: Setting) -> None:
    """Report what a driver that was closed has left in its process: threads and descriptors."""
    kernel, driver = scene.world.kernel, scene.driver
    assert driver is not None
    left = [
        str(task)
        for task in kernel.tasks
        if task.process is driver and not task.ended and task is not driver.main
    ]
    left += [f"descriptor {number}: {file}" for number, file in driver.files.items()]
    if left:
        scene.world.find("close leaves something behind", ", ".join(left))


class User:
    """A user of a device, who chooses by the world's generator.

    Args:
        scene: with the driver connected.
    """

    def __init__(self, scene: Scene) -> None:
        assert scene.arm is not None
        self._scene = scene
        self._arm: LocalDevice = scene.arm
        self._random = scene.world.random
        capabilities = self._arm.engine.capabilities
        self._lower = np.array([limit.lower for limit in capabilities.limits])
        self._upper = np.array([limit.upper for limit in capabilities.limits])
        offered = self._arm.crtk_commands
        self._actions: dict[str, Callable[[], None]] = {
            "hold": self._hold,
            "pause": self._pause,
            "disable": self._disable,
            "rest": lambda: self.pause(0.6),
            "second client": self._second_client,
            "nonsense": self._nonsense,
            "early move": self._early_move,
            "stop on the way": self._stop_on_the_way,
        }
        moving: dict[str, tuple[str, Callable[[], None]]] = {
            "move": ("move_jp", lambda: self.move(waits=True)),
            "move on": ("move_jp", lambda: self.move(waits=False)),
            "servo_jp": ("servo_jp", self._servo_positions),
            "servo_jv": ("servo_jv", self._servo_velocities),
            "two streams": ("servo_jp", self._two_streams),
        }
        for name, (command, action) in moving.items():
            if command in offered:
                self._actions[name] = action

    def work(self, operations: int) -> None:
        """Do so many things."""
        names = tuple(self._actions)
        for _ in range(operations):
            name = self._random.choice(names)
            self.attempt("enable", self.until_enabled)
            self.attempt(name, self._actions[name])

    def attempt(self, name: str, action: Callable[[], None]) -> None:
        """Do something that may be refused, with a reason."""
        world = self._scene.world
        if name != "enable":
            world.say(f"{name}, {self._arm.operating_state().state}")
        try:
            action()
        except CrtkError as error:
            world.say(f"  {type(error).__name__}: {error}")
            if not (world.wild or name in _MAY_FAIL or _waits_only(error)):
                world.find("it fails though nothing is wrong", f"{name}: {error}")
            if not str(error) or (isinstance(error, CommandRefused) and not error.detail):
                world.find("refused without a reason", repr(error))
            self.pause(0.3)

    def pause(self, most: float) -> None:
        """Do nothing for a while."""
        time.sleep(self._random.random() * most)

    def until_enabled(self) -> None:
        """Enable the device, whatever its state."""
        arm = self._arm
        if arm.is_enabled():
            return
        arm.wait_for_status(lambda status: status.state != OperatingState.FAULT, 0.5)
        if arm.operating_state().state == OperatingState.PAUSED:
            command = self._random.choice((StateCommand.RESUME, StateCommand.DISABLE))
            arm.state_command(command, _PATIENCE)
        if not arm.is_enabled():
            arm.enable(timeout=_PATIENCE)

    def _measured(self) -> Vector:
        found: Vector = self._arm.measured_js().position
        return found

    def _goal(self) -> Vector:
        step = self._scene.subject.step
        wanted = self._measured() + step * (2.0 * self._random.random() - 1.0)
        margin = np.minimum(0.05 * (self._upper - self._lower), step)
        return np.clip(wanted, self._lower + margin, self._upper - margin)

    def _send_move(self, goal: Vector) -> Move:
        with self._scene.sending():
            move: Move = self._arm.move_jp(goal)
            self._scene.sent(move)
        return move

    def _stream(self, name: str, values: Vector, arm: LocalDevice | None = None) -> None:
        silence = self._arm.engine.options.silence(find(name).level)
        with self._scene.sending(silence=silence):
            getattr(arm or self._arm, name)(values)

    def move(self, *, waits: bool) -> None:
        """Move, and wait until it is there, or not."""
        scene, goal = self._scene, self._goal()
        move = self._send_move(goal)
        self.pause(0.3)
        if not waits:
            return
        if not move.wait(_PATIENCE):
            if str(move.outcome) != "running":
                scene.world.find(
                    "wait contradicts the outcome", f"wait() returns False; {move.outcome}"
                )
            return
        if not scene.was_at(goal.tolist(), scene.now - _SEEN, scene.now, scene.arrival):
            scene.world.find(
                "reached too early",
                f"a move to {goal} is reached, and the joints are at {scene.joints}",
            )

    def _servo_positions(self) -> None:
        speed = self._scene.subject.velocity * (2.0 * self._random.random() - 1.0)
        start = self._set_last()
        for count in range(self._random.randrange(5, 40)):
            wanted = start + speed * _CYCLE * count * min(1.0, count / 10.0)
            self._stream("servo_jp", np.clip(wanted, self._lower, self._upper))
            time.sleep(_CYCLE)

    def _set_last(self) -> Vector:
        found: Vector = self._arm.setpoint_jp(age=0)
        return found if found.size else self._measured()  # what was set last may be a velocity

    def _servo_velocities(self) -> None:
        speed = self._scene.subject.velocity * (2.0 * self._random.random() - 1.0)
        wanted = np.full(self._lower.size, speed)
        for _ in range(self._random.randrange(5, 60)):
            self._stream("servo_jv", wanted)
            time.sleep(_CYCLE)

    def long_stream(self) -> None:
        """Stream velocities, if the device takes them, for longer than any driver lives that is killed."""
        if "servo_jv" not in self._arm.crtk_commands:
            return
        speed = self._scene.subject.velocity * self._random.choice((-1.0, 1.0))
        wanted = np.full(self._lower.size, speed)
        for _ in range(round(_PATIENCE / _CYCLE)):
            self._stream("servo_jv", wanted)
            time.sleep(_CYCLE)

    def _nonsense(self) -> None:
        """Send what must be refused, or must not be carried out as it is."""
        here, capabilities = self._set_last(), self._arm.engine.capabilities
        fastest = np.array([limit.velocity for limit in capabilities.limits])
        way = _JUMP * fastest * self._random.choice((-1.0, 1.0))
        chosen = self._random.choice(("nan", "short", "jump", "range"))
        values = {
            "nan": np.where(np.arange(here.size) == here.size - 1, math.nan, here),
            "short": here[:-1],
            "jump": here + way,
            "range": np.where(way > 0.0, self._upper, self._lower) + way,
        }[chosen]
        self._scene.world.say(f"  {chosen}")
        try:
            if chosen == "jump":  # is judged when it would be sent
                self._stream("servo_jp", values)
            else:
                self._send_move(values)
        except CommandRefused:
            return
        if chosen != "jump":
            self._scene.world.find("nonsense is accepted", f"move_jp {values}")

    def _stop_on_the_way(self) -> None:
        """Stop a long and slow move, and look on for as long as the device declares that a stop takes."""
        draw = self._random
        self.far_move()
        self.pause(draw.choice((0.0, 0.02, 0.5)))
        draw.choice((self._hold, self._pause, self._disable))()
        time.sleep(self._arm.engine.capabilities.stop.time + _LOOKS)

    def far_move(self) -> None:
        """Begin a long move, most often a slow one."""
        draw, step = self._random, self._scene.subject.step
        wanted = self._measured() + _FAR * step * draw.choice((-1.0, 1.0))
        margin = np.minimum(0.05 * (self._upper - self._lower), step)
        slow = _SLOWER in self._arm.crtk_commands and draw.random() < 0.7
        if slow:
            self._arm.trajectory_j.set_ratio_v(0.2)
        try:
            self._send_move(np.clip(wanted, self._lower + margin, self._upper - margin))
        finally:
            if slow:
                self._arm.trajectory_j.set_ratio_v(1.0)

    def _early_move(self) -> None:
        """Send a move while the device is being enabled, and stop it before that is done."""
        self._state(StateCommand.DISABLE, _PATIENCE)
        self._arm.state_command(StateCommand.ENABLE, 0.0)
        self._send_move(self._goal())
        self.pause(0.02)
        self._hold()
        self._arm.wait_for_status(lambda status: not status.is_busy, 0.3)

    def _two_streams(self) -> None:
        """Let another client stream while this one does: that is refused, as long as this one goes on."""
        other, start = LocalDevice(self._arm._session), self._set_last()  # noqa: SLF001
        for count in range(20):
            self._stream("servo_jp", start)
            sent = self._scene.now
            time.sleep(_CYCLE)
            if count < 10:
                continue
            try:
                self._stream("servo_jp", start, other)
            except CommandRefused:
                continue
            if self._scene.now - sent < _CYCLE + MOMENT:
                self._scene.world.find(
                    "two clients are mixed", "servo_jp is taken from another than who streams it"
                )
            return

    def _hold(self) -> None:
        self._never_refused("hold", self._arm.hold)
        self.pause(0.1)

    def _pause(self) -> None:
        self._state(StateCommand.PAUSE)

    def _disable(self) -> None:
        self._state(StateCommand.DISABLE)

    def _state(self, command: StateCommand, timeout: float | None = None) -> None:
        if timeout is None:
            timeout = self._random.choice((0.0, _PATIENCE))
        send = partial(self._arm.state_command, command, timeout)
        if command is StateCommand.DISABLE:
            self._never_refused(command, send)
        else:
            with self._scene.stopping():
                send()
        self.pause(0.05)

    def _never_refused(self, name: str, send: Callable[[], None]) -> None:
        """Send something that stops, with a fault around it in a wild world; it is never refused."""
        scene, engine = self._scene, self._arm.engine
        world = scene.world
        if world.wild:
            world.troubles.around(MOMENT)
        was_connected, begun = engine.connected, scene.now
        try:
            with scene.stopping():
                send()
            since = max(begun, scene.hindered)
            if name == "hold" and scene.now - since > _STOP_TAKES:
                world.find("a stop waits", f"hold took {scene.now - since:.3f} s")
        except CommandRefused as refusal:
            if was_connected and engine.connected:
                world.find("a stop is refused", f"{name}: {refusal}")
            raise

    def _second_client(self) -> None:
        """Let another thread stop the device in the middle of a move."""

        def stop() -> None:
            time.sleep(delay)
            try:
                self._never_refused("hold", self._arm.hold)
            except CrtkError as error:
                self._scene.world.say(f"  second client: {error}")

        delay = 0.2 * self._random.random()
        other = threading.Thread(target=stop, name="second client")
        other.start()
        try:
            self.attempt("second client", lambda: self.move(waits=True))
        finally:
            other.join()


def _waits_only(error: CrtkError) -> bool:
    """Whether a command was refused because what came before it is still being carried out."""
    return isinstance(error, CommandRefused) and error.reason in _WAITS
