"""Scenarios: a device is used at random, is closed in trouble, loses its driver, or stands still itself.

Each takes a world and a subject. Wrap one into a function of the world alone, at the top level of a file, and
it can be run with any seed.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Final

from crtk_drivers.errors import CrtkError, DeviceError
from crtk_drivers.testing.world.machine.kernel import NS
from crtk_drivers.testing.world.promises import operations as script
from crtk_drivers.testing.world.promises.acting import MOMENT, PATIENCE, User
from crtk_drivers.testing.world.promises.judges import judge
from crtk_drivers.testing.world.promises.streaming import stream
from crtk_drivers.testing.world.promises.subject import Scene, Setting, Subject
from crtk_drivers.testing.world.world import World

COMES_BACK: Final = 15.0
"""s in which a driver works again once nothing goes wrong any more: pauses of its attempts grow to 5 s."""
_AFTERWARDS: Final = 0.5
_AFTER_DEATH: Final = 4.0
_STANDS_STILL: Final = 2.0
"""s for which a simulator's process is stopped: longer than any driver waits for a sample."""
_LONG: Final = ("far move", "long stream")
"""What a driver may be killed in."""
_BLOCKED: Final = 0.5
"""s before a death within which the network may be blocked."""
_FREED: Final = 2.5
"""s after a death within which it is free again: later than the devices declare for a stop, too."""
_AGAIN: Final = 0.4
"""Share of worlds in which somebody connects again after `close`, and of those that are closed in use."""
_LOOKS_ON: Final = 1.0
_MEANWHILE: Final = (
    "move",
    "servo_jp",
    "stop on the way",
    "service",
    "home",
    "free",
    "falls silent",
)
"""What another thread may do while the driver is closed."""


def use(world: World, subject: Subject, *, operations: int = 25, faults: int = 10) -> None:
    """Use a device in any way for some seconds, and close it.

    Args:
        world, subject: where and what.
        operations: how many things the user does.
        faults: how many come meanwhile, at most.
    """

    def work(scene: Scene) -> None:
        storm(world, 0.25 * operations, faults)
        script.work(User(scene), operations)
        close(scene, _begin_something(scene) if world.random.random() < _AGAIN else None)
        if scene.closed is not None and world.random.random() < _AGAIN:
            _connect_again(scene)

    _play(world, subject, work)


def farewell(world: World, subject: Subject) -> None:
    """Let a fault and `close` come within milliseconds of each other, in a move."""

    def work(scene: Scene) -> None:
        user = User(scene)
        user.attempt("enable", user.until_enabled)
        if world.wild:
            world.troubles.around(0.2, chance=1.0)
        user.pause(0.1)
        user.attempt("move", partial(user.move, waits=False))
        user.pause(world.random.choice((0.03, 0.1, 0.8)))
        close(scene)

    _play(world, subject, work)


def die(world: World, subject: Subject) -> None:
    """Kill the driver's process while it works, or let its machine vanish; then only the device can stop."""
    silently = world.random.random() < 0.5

    def work(scene: Scene) -> None:
        user = User(scene)
        is_cut = world.wild and world.random.random() < 0.5
        begins = world.random.choice(_LONG if is_cut else ("", *_LONG))
        if begins:
            user.attempt("enable", user.until_enabled)
        moment = 0.2 + 2.0 * world.random.random()
        world.kernel.after(moment, partial(kill, scene, silently=silently))
        if is_cut:  # what it sends meanwhile is delivered when it is gone
            before = _BLOCKED * world.random.random()
            world.troubles.block(max(0.0, moment - before), before + _FREED * world.random.random())
        if begins == "far move":
            user.attempt("far move", user.far_move)
            time.sleep(PATIENCE)
        elif begins and "servo_jv" in user.arm.crtk_commands:
            user.attempt("long stream", partial(stream, user, "servo_jv", PATIENCE))
        script.work(user, 1000)

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
        if connects(scene):
            work(scene)

    world.join(world.start("driver", drive))


def connects(scene: Setting, within: float = math.inf) -> bool:
    """Connect the driver of this process, and return whether it did.

    Args:
        scene: where it is.
        within: s after the last trouble in which it must.
    """
    world = scene.world
    scene.driver = world.kernel.process
    try:
        scene.connect()
    except CrtkError as error:
        world.say(f"no connection: {error}")
        if scene.now > scene.hindered + within:
            world.find("it does not come back", f"no connection: {error}")
        return False
    return True


def storm(world: World, seconds: float, faults: int) -> None:
    """Let up to so many faults come within some s.

    Without bad weather the wall clock alone is set, and nothing may depend on that.
    """
    world.troubles.storm(0.05, seconds, faults, () if world.wild else ("step clock",))


def kill(scene: Setting, *, silently: bool = False) -> None:
    """Kill the driver's process, or let its machine vanish `silently`."""
    world = scene.world
    assert scene.driver is not None
    scene.died = scene.now
    world.say("the driver's machine vanishes" if silently else "the driver is killed")
    world.kernel.end_process(scene.driver, -9, silently=silently)


def _connect_again(scene: Scene) -> None:
    """Connect once more to what was closed, look on, perhaps use it, and close it."""
    world = scene.world
    world.say("connect again")
    try:
        scene.connect()
    except CrtkError as error:
        world.say(f"no connection: {error}")
        if not world.wild:
            world.find("it fails though nothing is wrong", f"connect: {error}")
        return
    time.sleep(_LOOKS_ON)
    script.work(User(scene), world.random.randrange(3))
    close(scene)


def _begin_something(scene: Scene) -> threading.Thread:
    """Let another thread do one of `_MEANWHILE` from now on."""
    user = User(scene)
    found = script.offered(user)
    name = scene.world.random.choice([each for each in _MEANWHILE if each in found])
    act = partial(script.do, user, name, found[name], may_fail=True)
    thread = threading.Thread(target=act, name="meanwhile")
    thread.start()
    user.pause(0.3)
    return thread


def close(scene: Setting, meanwhile: threading.Thread | None = None) -> None:
    """Close the driver, perhaps while another thread uses it, and go on looking for a while."""
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
    if meanwhile is not None:
        meanwhile.join()
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
