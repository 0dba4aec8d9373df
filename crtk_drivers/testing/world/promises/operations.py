"""What users do with a device, as a table: each operation, what it needs, and how often it is chosen."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from crtk_drivers.commands import Payload, Space, find
from crtk_drivers.engine.services import OwnService, Request
from crtk_drivers.errors import CommandRefused, CrtkError, Reason
from crtk_drivers.motion.move import Outcome
from crtk_drivers.samples import Pose, vector
from crtk_drivers.state import StateCommand
from crtk_drivers.testing.world.promises.acting import LOOKS, MOMENT, PATIENCE, User
from crtk_drivers.testing.world.promises.streaming import (
    CYCLE,
    PERIODS,
    SLOW_PERIODS,
    stream,
    stream_once,
)

_JUMP: Final = 0.6
"""s at full speed that a jump is long."""
_TOOL_STEP: Final = 0.05
"""m of the longest move of the tool."""
_RATIOS: Final = (0.1, 0.3, 1.0)
_SERVICE_TAKES: Final = 40.0
_UNTIL_FREE: Final = 1.0
_REACH: Final = frozenset({Reason.UNREACHABLE, Reason.OUT_OF_RANGE, Reason.STEP_TOO_LARGE})
"""Why a pose may be refused that is near to where the tool is: a joint's range, a singularity."""


@dataclass(frozen=True, kw_only=True)
class Operation:
    """Something that users do.

    Attributes:
        act: does it.
        needs: CRTK names that the device must offer.
        suits: whether it can be done with a device that offers them.
        weight: how often it is chosen, against the others.
        may_fail: it may fail though nothing goes wrong: it is stopped on purpose.
        may_be: for these reasons it may be refused though nothing goes wrong.
        in_any_state: the device need not be ENABLED.
    """

    act: Callable[[User], None]
    needs: tuple[str, ...] = ()
    suits: Callable[[User], bool] = lambda user: True
    weight: int = 1
    may_fail: bool = False
    may_be: frozenset[Reason] = frozenset()
    in_any_state: bool = False


def offered(user: User) -> dict[str, Operation]:
    """Return the operations that a device offers, by name."""
    names = user.arm.crtk_commands
    return {
        name: each
        for name, each in OPERATIONS.items()
        if all(needed in names for needed in each.needs) and each.suits(user)
    }


def work(user: User, count: int) -> None:
    """Do so many things, one after the other."""
    found = offered(user)
    names, weights = list(found), [each.weight for each in found.values()]
    for _ in range(count):
        (name,) = user.random.choices(names, weights)
        do(user, name, found[name])


def do(user: User, name: str, what: Operation, *, may_fail: bool = False) -> None:
    """Do one of them, in a device that is ENABLED if that is needed."""
    if not what.in_any_state:
        user.attempt("enable", user.until_enabled, may_fail=may_fail)
    user.attempt(
        name, partial(what.act, user), may_fail=may_fail or what.may_fail, may_be=what.may_be
    )


# Moves


def _move_by(user: User) -> None:
    """Move by an increment, and wait until it is there."""
    start = user.set_last()
    move = user.send("move_jr", user.within(start + user.signed(user.scene.subject.step)) - start)
    if user.await_reached(move):  # where it goes is known once it has begun: it may have waited
        user.see_reached(move, user.arm.goal_jp(age=0))


def _move_tool(user: User) -> None:
    """Move the tool on a short straight line, and wait until it is there or not."""
    shift = user.way(_TOOL_STEP)
    if user.random.random() < 0.5:
        move = user.send("move_cr", [*shift, 0.0, 0.0, 0.0, 1.0])
    else:
        here: Pose = user.arm.measured_cp()
        move = user.send("move_cp", Pose(vector(here.position + shift), here.orientation))
    if user.random.random() < 0.7:
        user.await_reached(move)


def _replaced_move(user: User) -> None:
    """Send a move while another one is on its way: that never counts as reached."""
    first, goal = user.far_move()
    user.pause(0.3)
    was_busy = first.is_busy()
    by = user.random.choice((user.arm, user.other))
    second_goal = user.goal()
    second = user.send_move(second_goal, by)
    replaced_at = user.scene.now
    user.await_reached(second, second_goal)
    is_reached = was_busy and first.outcome is Outcome.REACHED
    if is_reached and not user.was_at(goal, user.scene.now - replaced_at + LOOKS):
        text = f"the one to {goal}; the joints are at {user.scene.joints}"
        user.scene.world.find("a replaced move is reached", text)


def _at_another_ratio(user: User) -> None:
    """Move with other shares of the limits than before."""
    ratios, draw = user.arm.trajectory_j, user.random
    draw.choice((ratios.set_ratio, ratios.set_ratio_v, ratios.set_ratio_a))(draw.choice(_RATIOS))
    try:
        user.move(waits=draw.random() < 0.7)
    finally:
        ratios.set_ratio(1.0)


# Streams


def _falls_silent(user: User) -> None:
    """Stream, be silent for longer than a stream may be, and begin anew from there."""
    streams = [name for name in ("servo_jp", "servo_jv") if name in user.arm.crtk_commands]
    name = user.random.choice(streams)
    stream(user, name, 0.2)
    stop = user.engine.capabilities.stop.time
    time.sleep(user.silence(name) + user.random.choice((0.05, 0.3, stop + LOOKS)))
    stream(user, name, 0.2)


def _nonsense(user: User) -> None:
    """Send what must be refused, or must not be carried out as it is."""
    here, capabilities = user.set_last(), user.engine.capabilities
    fastest = np.array([limit.velocity for limit in capabilities.limits])
    way = _JUMP * fastest * user.random.choice((-1.0, 1.0))
    chosen = user.random.choice(("nan", "short", "jump", "range"))
    values = {
        "nan": np.where(np.arange(here.size) == here.size - 1, math.nan, here),
        "short": here[:-1],
        "jump": here + way,
        "range": np.where(way > 0.0, user.upper, user.lower) + way,
    }[chosen]
    user.scene.world.say(f"  {chosen}")
    try:
        if chosen == "jump":  # is judged when it would be sent
            user.stream("servo_jp", values)
        else:
            user.send_move(values)
    except CommandRefused:
        return
    if chosen != "jump" and not user.is_far:  # a refusal from far away may be late
        user.scene.world.find("nonsense is accepted", f"move_jp {values}")


# Stops, states


def _stop_on_the_way(user: User) -> None:
    """Stop a slow move or a stream, and look on for as long as the device declares that a stop takes."""
    if "servo_jv" in user.arm.crtk_commands and user.random.random() < 0.5:
        stream(user, "servo_jv", 0.2)
    else:
        user.far_move()
        user.pause(user.random.choice((0.0, 0.02, 0.5)))
    user.stop_anyhow()
    time.sleep(user.engine.capabilities.stop.time + LOOKS)


def _early_move(user: User) -> None:
    """Send a move while the device is being enabled, and stop it before that is done."""
    user.state(StateCommand.DISABLE, PATIENCE)
    user.arm.state_command(StateCommand.ENABLE, 0.0)
    user.send_move(user.goal())
    user.pause(0.02)
    user.hold()
    user.arm.wait_for_status(lambda status: not status.is_busy, 0.3)


def _free(user: User) -> None:
    """Let the arm be moved by hand, and take it back in some way or leave it so."""
    engine, scene = user.engine, user.scene
    scene.sends_free(user.arm.free)
    engine.wait_for(lambda: scene.is_free, _UNTIL_FREE)
    user.pause(0.5)
    back: tuple[Callable[[], object], ...] = (
        user.stop_anyhow,
        lambda: user.move(waits=True),
        lambda: stream(user, "servo_jp", 0.2),
        lambda: None,
    )
    user.random.choice(back)()


def _home(user: User) -> None:
    """Find the reference positions again; perhaps with a stop on the way."""
    draw, arm, scene = user.random, user.arm, user.scene
    user.state(StateCommand.UNHOME, PATIENCE)
    is_stopped = draw.random() < 0.5
    user.state(StateCommand.HOME, 0.0 if is_stopped else _SERVICE_TAKES)
    if is_stopped:
        user.pause(draw.choice((0.02, 0.5, 3.0)))
        user.stop_anyhow()
        if user.engine._transitions.running is StateCommand.HOME:  # noqa: SLF001 - no front says which
            scene.world.find("home goes on after a stop", str(arm.operating_state()))
        time.sleep(user.engine.capabilities.stop.time + LOOKS)
    elif not (scene.world.wild or arm.is_homed()):
        scene.world.find("home contradicts is_homed", "home has ended, and it is not homed")


def _unhome(user: User) -> None:
    """Forget the reference positions."""
    user.state(StateCommand.UNHOME)
    user.pause(0.3)


# What it does and takes beyond CRTK


class _Asked:
    """A service that moves the device: a motion is asked for until it has ended."""

    def __init__(self, request: Request) -> None:
        self._request = request

    def is_busy(self) -> bool:
        """Whether it has not ended."""
        return not self._request.has_ended


def _services(user: User) -> list[str]:
    left_out = user.scene.subject.without
    return [
        name
        for name, service in user.engine.services.items()
        if not isinstance(service, OwnService) and name not in left_out
    ]


def _service(user: User) -> None:
    """Ask for one of the device's own services, in any state and perhaps in a move."""
    draw, engine, scene = user.random, user.engine, user.scene
    name = draw.choice(_services(user))
    scene.world.say(f"  {name}")
    user.has_interfered = True
    if draw.random() < 0.3:
        user.far_move()
        user.pause(0.1)
    service = engine.services[name]
    if service.stops:
        with scene.stopping():
            request = engine.request(name)
    elif getattr(service, "moves", False):
        with scene.sending():
            request = engine.request(name)
            scene.sent(_Asked(request))
        if draw.random() < 0.5:
            user.pause(draw.choice((0.02, 1.0)))
            user.stop_anyhow()
    else:
        request = engine.request(name)
    scene.world.say(f"  {name}: {request.wait(draw.choice((0.5, _SERVICE_TAKES)))}")


def _inputs(user: User) -> list[str]:
    inputs = user.engine.inputs.items()
    return [name for name, taken in inputs if taken.payload in (Payload.FLAG, Payload.NUMBER)]


def _input(user: User) -> None:
    """Give the device a value of its own that moves nothing: an output, or no number for a number."""
    name = user.random.choice(_inputs(user))
    is_flag = user.engine.inputs[name].payload is Payload.FLAG
    value = user.random.random() < 0.5 if is_flag else math.nan
    user.scene.world.say(f"  {name} {value}")
    try:
        user.arm.extras[name](value)
    except CommandRefused:
        if is_flag:
            raise
    else:
        if not is_flag:
            user.scene.world.find("nonsense is accepted", f"{name} {value}")


# Two clients


def _second_client(user: User) -> None:
    """Let another client stop, disable or move the device in the middle of a move."""
    draw = user.random
    delay = 0.2 * draw.random()
    what: Callable[[], object] = draw.choice(
        (
            lambda: user.hold(user.other),
            lambda: user.hold(user.other),
            lambda: user.state(StateCommand.DISABLE),
            lambda: user.send_move(user.goal(), user.other),
        )
    )

    def interfere() -> None:
        time.sleep(delay)
        try:
            what()
        except CrtkError as error:
            user.scene.world.say(f"  second client: {error}")

    other = threading.Thread(target=interfere, name="second client")
    other.start()
    try:
        user.move(waits=True, seen=PATIENCE)  # the other one may have moved on
    finally:
        other.join()


def _two_streams(user: User) -> None:
    """Let another client stream while this one does: that is refused, as long as this one goes on."""
    start = user.set_last()
    for count in range(20):
        user.stream("servo_jp", start)
        sent = user.scene.now
        time.sleep(CYCLE)
        if count < 10:
            continue
        try:
            user.stream("servo_jp", start, user.other)
        except CommandRefused:
            continue
        if user.scene.now - sent < CYCLE + MOMENT:
            user.scene.world.find(
                "two clients are mixed", "servo_jp is taken from another than who streams it"
            )
        return


def _client_goes(user: User) -> None:
    """Let a second client go away in the middle of its stream or move; somebody else goes on then."""
    other = user.another()
    if user.random.random() < 0.5:
        stream(user, "servo_jp", 0.2, arm=other)
    else:
        user.send_move(user.goal(), other)
        user.pause(0.2)
    user.scene.world.say("  it goes away")
    user.leaves(other)
    user.pause(user.random.choice((0.05, 1.0)))
    user.move(waits=True)


def _move_waits(user: User) -> None:
    user.move(waits=True)


def _move_on(user: User) -> None:
    user.move(waits=False)


def _of(name: str, *needs: str, periods: Sequence[float] = PERIODS) -> Operation:
    """Return the operation that is a stream; one of the tool may come to where it cannot go on."""
    may_be = _REACH if find(name).space is Space.CARTESIAN else frozenset[Reason]()
    return Operation(act=stream_once(name, periods), needs=(name, *needs), may_be=may_be)


OPERATIONS: Final = {
    "move": Operation(act=_move_waits, needs=("move_jp",), weight=3),
    "move on": Operation(act=_move_on, needs=("move_jp",), weight=3),
    "move_jr": Operation(act=_move_by, needs=("move_jr", "goal_js")),
    "move the tool": Operation(
        act=_move_tool, needs=("move_cp", "move_cr", "measured_cp"), may_be=_REACH
    ),
    "replaced move": Operation(act=_replaced_move, needs=("move_jp",)),
    "another ratio": Operation(
        act=_at_another_ratio, needs=("move_jp", "trajectory_j/set_ratio_a")
    ),
    "servo_jp": Operation(act=stream_once("servo_jp"), needs=("servo_jp",), weight=3),
    "servo_jv": Operation(act=stream_once("servo_jv"), needs=("servo_jv",), weight=3),
    "servo_jr": _of("servo_jr"),
    "servo_jf": _of("servo_jf"),
    "servo_cp": _of("servo_cp", "measured_cp"),
    "servo_cv": _of("servo_cv"),
    "servo_cf": _of("servo_cf"),
    "interpolate_jp": _of("interpolate_jp", periods=SLOW_PERIODS),
    "falls silent": Operation(act=_falls_silent, needs=("servo_jp",)),
    "nonsense": Operation(act=_nonsense, needs=("move_jp", "servo_jp"), weight=3),
    "hold": Operation(act=User.hold, weight=3),
    "pause": Operation(act=lambda user: user.state(StateCommand.PAUSE), weight=3),
    "disable": Operation(act=lambda user: user.state(StateCommand.DISABLE), weight=3),
    "rest": Operation(act=lambda user: user.pause(0.6), weight=3),
    "early move": Operation(act=_early_move, needs=("move_jp",), weight=3, may_fail=True),
    "stop on the way": Operation(act=_stop_on_the_way, needs=("move_jp",), weight=6, may_fail=True),
    "free": Operation(
        act=_free,
        needs=("free", "move_jp", "servo_jp"),
        suits=lambda user: not user.is_far,
        weight=2,
    ),
    "home": Operation(
        act=_home, suits=lambda user: user.engine.capabilities.needs_homing, weight=2
    ),
    "unhome": Operation(
        act=_unhome,
        suits=lambda user: user.engine.capabilities.needs_homing,
        in_any_state=True,
    ),
    "service": Operation(
        act=_service,
        suits=lambda user: bool(_services(user)) and not user.is_far,
        weight=2,
        may_fail=True,
        in_any_state=True,
    ),
    "input": Operation(
        act=_input,
        suits=lambda user: bool(_inputs(user)) and not user.is_far,
        in_any_state=True,
    ),
    "second client": Operation(act=_second_client, needs=("move_jp",), weight=3, may_fail=True),
    "two streams": Operation(
        act=_two_streams, needs=("servo_jp",), suits=lambda user: not user.is_far, weight=3
    ),
    "client goes away": Operation(act=_client_goes, needs=("servo_jp", "move_jp")),
}
"""All of them, by name. What finds most of the mistakes that are planted is chosen most often."""
