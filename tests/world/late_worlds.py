"""Worlds in which commands reach a node long after they were sent; imported in patched Python."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

from crtk_msgs.msg import StringStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty
from world.ros_worlds import FOUND, RELIABLE, program

from crtk_drivers.client import connect
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused
from crtk_drivers.ros.serving import Serving
from crtk_drivers.session import Session
from crtk_drivers.status.stop_request import StopRequest
from crtk_drivers.testing.loopback import PLUGIN, LoopbackConfig
from crtk_drivers.testing.world import World

_SPACE: Final = "/late"
_BETWEEN: Final = 4.0
"""s after a stream until its publisher has heard that all of it has come, and sends no more heartbeats."""
_TYPES: Final[dict[str, Any]] = {
    "hold": Empty,
    "move_jp": JointState,
    "servo_jv": JointState,
    "servo_jr": JointState,
    "state_command": StringStamped,
}


class _Sender:
    """A program that sends what no client of ours would: nothing is confirmed, and nothing sent again."""

    def __init__(self, world: World, node: Any) -> None:
        self._world = world
        self._publishers = {
            name: node.create_publisher(kind, f"{_SPACE}/{name}", RELIABLE)
            for name, kind in _TYPES.items()
        }
        time.sleep(FOUND)

    def state(self, command: str) -> None:
        """Send a state command."""
        self._publishers["state_command"].publish(StringStamped(string=command))

    def hold(self) -> None:
        """Send hold."""
        self._publishers["hold"].publish(Empty())

    def move(self) -> None:
        """Send a move by 1 rad."""
        self._publishers["move_jp"].publish(JointState(position=[1.0, 0.0, 0.0, 0.0]))

    def increment(self) -> None:
        """Send an increment."""
        self._publishers["servo_jr"].publish(JointState(position=[0.001, 0.0, 0.0, 0.0]))

    def velocity(self) -> None:
        """Send a setpoint of a velocity."""
        self._publishers["servo_jv"].publish(JointState(velocity=[0.1, 0.0, 0.0, 0.0]))

    def stream(self, seconds: float) -> None:
        """Stream a velocity at 50 Hz."""
        for _ in range(round(50.0 * seconds)):
            self.velocity()
            time.sleep(0.02)

    def lose(self, send: Callable[[], None]) -> None:
        """Send something that the network loses; DDS repeats it with its heartbeat."""
        self._world.troubles.block(0.0, 0.1)
        time.sleep(0.01)
        send()


def _engine_of(world: World, ends: StopRequest) -> tuple[Engine, Any]:
    """Serve a device from another process, until it is to end."""
    session = Session(PLUGIN, LoopbackConfig(rate=100.0))

    def serve() -> None:
        with Serving(session.engine, _SPACE, [], None, session.children) as serving, session:
            serving.spin(ends)

    driver = world.start("driver", serve)
    while not session.engine.has_sample:
        time.sleep(0.01)
    return session.engine, driver


def _tried(world: World, work: Callable[[_Sender, Engine], None]) -> dict[str, Any]:
    """Return what an enabled device does in the 6 s after a program has worked.

    Returns:
        Whether it moved in that time, its state at the end, and all that was refused.
    """
    worked, ends = StopRequest(), StopRequest()
    engine, driver = _engine_of(world, ends)
    engine.state_command("enable")
    while engine.status.state != "ENABLED":
        time.sleep(0.01)
    begun = engine.health().refusals

    def be_program() -> None:
        with program("sends") as node:
            work(_Sender(world, node), engine)
            worked.set()
            time.sleep(10.0)

    sender = world.start("sends", be_program)
    while not worked.is_set():
        time.sleep(0.01)
    stood = _position(engine)
    time.sleep(6.0)
    found = {
        "moved": abs(_position(engine) - stood) > 1e-6,
        "state": str(engine.status.state),
        "refused": {
            what: count - begun.get(what, 0) for what, count in engine.health().refusals.items()
        },
    }
    world.kernel.end_process(sender, -9)
    ends.set()
    world.join(driver)
    return found


def _position(engine: Engine) -> float:
    found = engine.feedback("measured_js")
    assert found is not None
    return float(found[0].position[0])  # type: ignore[union-attr]


def lost(world: World, what: str, knows: bool, stop: str) -> dict[str, Any]:
    """Lose a command, which comes 3 s later; perhaps somebody stops the device in between.

    Args:
        world: fair.
        what: name of what is lost, a method of `_Sender`, or a state command.
        knows: whether its program has sent anything before.
        stop: command that the driver gets 0.2 s after it was sent, or none.
    """

    def work(sender: _Sender, engine: Engine) -> None:
        if knows:
            sender.stream(1.0)
            time.sleep(_BETWEEN)
        if what in ("enable", "resume"):
            engine.state_command("disable" if what == "enable" else "pause")
            time.sleep(0.2)
            sender.lose(lambda: sender.state(what))
        else:
            sender.lose(getattr(sender, what))
        time.sleep(0.2)
        if stop == "hold":
            engine.submit(stop)
        elif stop:
            engine.state_command(stop)

    return _tried(world, work)


def clock_set(world: World, seconds: float, idles: bool) -> dict[str, Any]:
    """Set the clock of the machine while a program streams, or while it does not."""

    def work(sender: _Sender, engine: Engine) -> None:
        sender.stream(1.0)
        if idles:
            time.sleep(3.0)
        world.kernel.wall_offset += round(1e9 * seconds)
        sender.stream(5.5)

    return _tried(world, work)


def _make_uneven(world: World) -> None:
    """Let the network keep half of the datagrams for up to 20 ms."""
    weather: Any = world.network.weather
    weather.late, weather.lateness = 0.5, 0.02


def own_order(world: World) -> dict[str, Any]:
    """Stop and go on at once, again and again, over an uneven network."""
    _make_uneven(world)

    def work(sender: _Sender, engine: Engine) -> None:
        for _ in range(60):
            sender.hold()
            sender.move()
            time.sleep(0.06)

    return _tried(world, work)


def client_stops(world: World) -> dict[str, Any]:
    """Let a client stop its own stream, again and again, over an uneven network.

    Returns:
        What was refused by the driver, and what the client was told of that.
    """
    _make_uneven(world)
    told: list[str] = []
    ends = StopRequest()
    engine, driver = _engine_of(world, ends)

    def work() -> None:
        with connect(_SPACE, timeout=10.0) as arm:
            arm.enable()
            for _ in range(20):
                try:
                    for _ in range(5):
                        arm.servo_jv([0.01, 0.0, 0.0, 0.0])
                        time.sleep(0.02)
                    arm.servo_jv([0.01, 0.0, 0.0, 0.0])
                    arm.hold()
                except CommandRefused as refusal:
                    told.append(str(refusal))
                time.sleep(0.2)

    world.join(world.start("client", work))
    refused = dict(engine.health().refusals)
    ends.set()
    world.join(driver)
    return {"refused": refused, "told": told}
