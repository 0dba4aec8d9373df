"""A user on the far side of ROS 2: the driver is a node, and the user another process, or a few.

What users do, and the judges, are those of `user`. Between the two are the topics of CRTK: a command may be
late, or come again once a heartbeat has told that it was lost, and the process that sent it may be gone.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any, Final

from typing_extensions import override

from crtk_drivers.errors import CrtkError
from crtk_drivers.motion.move import Move
from crtk_drivers.status.stop_request import StopRequest
from crtk_drivers.testing.world.machine.kernel import Process
from crtk_drivers.testing.world.promises import operations as script
from crtk_drivers.testing.world.promises.acting import User
from crtk_drivers.testing.world.promises.judges import judge
from crtk_drivers.testing.world.promises.subject import Busy, Scene, Subject
from crtk_drivers.testing.world.promises.user import close, connects, storm
from crtk_drivers.testing.world.world import World

NAMESPACE: Final = "/far"
_MEETS: Final = 30.0
"""s in which a client finds the driver."""
_SEEN: Final = 5.0
"""s for which a goal counts as reached: what tells of it may come with the next heartbeat."""
_STOP_TAKES: Final = 3.5
"""s in which a stop is confirmed, or said not to be (`crtk_drivers.client.remote.CONFIRM_TIMEOUT`). A client
that has just begun may hear of the state with a heartbeat after 3 s, and only then of a refusal."""
_LATE: Final = 0.4
"""s by which a setpoint is late at most that is not lost, in bad weather."""
_DIES: Final = 0.4
"""Share of the clients that are killed."""


class FarUser(User):
    """A user whose device is a `crtk_drivers.client`.

    Args:
        scene: with the driver connected, in another process.
        arm: as this process has it.
    """

    is_far = True
    stop_takes = _STOP_TAKES

    def __init__(self, scene: Scene, arm: Any) -> None:
        self._clients: list[Any] = []
        super().__init__(scene)
        self.arm = arm

    @override
    def another(self) -> Any:
        from crtk_drivers.client import connect

        found = connect(NAMESPACE, timeout=_MEETS)
        self._clients.append(found)
        return found

    @override
    def leaves(self, client: Any) -> None:
        client.close()

    @override
    def send(self, name: str, value: object, arm: Any = None) -> Move:
        """Send a move by its name; it may come, and be carried out, though its sender is killed meanwhile."""
        sending = _Sending(self.scene)
        self.scene.sent(sending)
        try:
            return super().send(name, value, arm)
        finally:
            sending.is_over = True

    @override
    def asked(self, move: Move) -> Busy:
        return _Asked(move, self.scene)

    @override
    def silence(self, name: str) -> float:
        return super().silence(name) + (_LATE if self.scene.world.wild else 0.0)

    @override
    def await_reached(self, move: Move, goal: Any = None, seen: float = _SEEN) -> bool:
        return super().await_reached(move, goal, max(seen, _SEEN))

    def close(self) -> None:
        """Close the clients that it has beside its own."""
        for each in self._clients:
            each.close()


class _Sending:
    """A move that is being sent: it is asked for until that is over, or the driver has done it.

    Attributes:
        is_over: whether it has been sent.
    """

    is_over = False

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._until = scene.now + _SEEN

    def is_busy(self) -> bool:
        """Whether it is asked for."""
        engine = self._scene.engine
        goes_on = self._scene.now < self._until or (engine is not None and engine.status.is_busy)
        return goes_on and not self.is_over


class _Asked(_Sending):
    """A move that was sent: it is asked for until its client knows its end, or the driver has done it."""

    def __init__(self, move: Any, scene: Scene) -> None:
        super().__init__(scene)
        self._move = move

    @override
    def is_busy(self) -> bool:
        self.is_over = self._move.has_ended
        return super().is_busy()


def far(world: World, subject: Subject, *, operations: int = 8, faults: int = 4) -> None:
    """Use a device through its node for some seconds; a client may die, and another one goes on."""
    scene = Scene(world, subject)
    judge(scene)
    ends, serves = StopRequest(), StopRequest()
    driver = world.start("driver", lambda: _serve(scene, serves, ends))
    while driver.alive and not serves.is_set():
        time.sleep(0.01)
    if not serves.is_set():
        return
    storm(world, 0.5 * operations, faults)
    for number in range(world.random.choice((1, 2))):
        client = world.start(f"client {number}", partial(_use, scene, operations))
        if world.random.random() < _DIES:
            world.kernel.after(0.5 + 4.0 * world.random.random(), partial(_kill, scene, client))
        world.join(client)
    ends.set()
    world.join(driver)


def _serve(scene: Scene, serves: StopRequest, ends: StopRequest) -> None:
    """Be the driver: a node of the device, until it is to end."""
    from crtk_drivers.ros.serving import Serving

    if not connects(scene):
        return
    assert scene.arm is not None
    with Serving(scene.arm.engine, NAMESPACE) as serving:
        serves.set()
        serving.spin(ends)
    close(scene)


def _use(scene: Scene, operations: int) -> None:
    """Be a client."""
    from crtk_drivers.client import connect

    world = scene.world
    try:
        arm: Any = connect(NAMESPACE, timeout=_MEETS)
    except CrtkError as error:
        world.say(f"no connection: {error}")
        if not world.wild:
            world.find("it fails though nothing is wrong", f"connect: {error}")
        return
    try:
        user = FarUser(scene, arm)
        try:
            script.work(user, operations)
        finally:
            user.close()
    finally:
        arm.close()


def _kill(scene: Scene, client: Process) -> None:
    if client.alive:
        scene.world.say("the client is killed")
        scene.world.kernel.end_process(client, -9)
