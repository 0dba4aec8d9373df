"""Each kind of message on the way to a stop is lost, doubled, late, split or cut off once: the arm stops."""

import struct
from collections.abc import Iterator
from contextlib import suppress

import pytest

from crtk_driver_ur.native.program import Kind
from crtk_drivers.errors import CommandRefused, CrtkError, MotionAborted
from rigs.ur_bench import FAR, LONG, QUICK_WATCHDOG, WAYS, UrBench, eventually
from rigs.ur_proxy import RTDE, Proxy, bench_at_proxy

CONFIG = {"open_timeout": 5.0, "watchdog_frequency": QUICK_WATCHDOG}
DATA = ord("U")
FEED_SIZE, MOTION_SIZE = 3 + 1 + 2 * 4, 3 + 1 + 4 * 4 + 9 * 8
"""Bytes of packages for our control program: header, recipe, integers, numbers."""
STOPPED = 1
"""Value of `runtime_state`."""
STOP_CODES = frozenset({15, 16, 34})
"""Of ur-rtde's commands: speedStop, servoStop, stopJ."""

ACTIONS = ("lost", "doubled", "late", "split", "cut")


def commands(port: int, inward: bool, message: bytes, kind: Kind) -> bool:
    if not (port == RTDE and inward and message[2] == DATA and len(message) == MOTION_SIZE):
        return False
    return bool(struct.unpack_from(">3i", message, 4)[2] == kind)


def is_rest(port: int, inward: bool, message: bytes) -> bool:
    return commands(port, inward, message, Kind.REST)


def is_quit(port: int, inward: bool, message: bytes) -> bool:
    return commands(port, inward, message, Kind.QUIT)


def is_feed(port: int, inward: bool, message: bytes) -> bool:
    return port == RTDE and inward and message[2] == DATA and len(message) == FEED_SIZE


def is_state(port: int, inward: bool, message: bytes) -> bool:
    return port == RTDE and not inward and message[2] == DATA and len(message) > 500


def is_library_stop(port: int, inward: bool, message: bytes) -> bool:
    is_command = port == RTDE and inward and message[2] == DATA and len(message) >= 8
    return is_command and struct.unpack_from(">i", message, 4)[0] in STOP_CODES


def is_power_off(port: int, inward: bool, message: bytes) -> bool:
    return inward and message == b"power off\n"


def is_power_off_answer(port: int, inward: bool, message: bytes) -> bool:
    return not inward and b"Powering off" in message


KINDS = {
    "native": {
        "rest": (is_rest, "hold"),
        "feed": (is_feed, "hold"),
        "state": (is_state, "hold"),
        "quit": (is_quit, "disable"),
        "power off": (is_power_off, "disable"),
        "its answer": (is_power_off_answer, "disable"),
    },
    "ur_rtde": {
        "stop": (is_library_stop, "hold"),
        "state": (is_state, "hold"),
        "power off": (is_power_off, "disable"),
    },
}
"""By control: kinds of messages, and the command on whose way they are."""


@pytest.fixture(scope="module", params=WAYS)
def world(request) -> Iterator[tuple[UrBench, Proxy]]:
    with bench_at_proxy({**CONFIG, "control": request.param}) as world:
        yield world


@pytest.mark.sweep(16)
@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("kind", sorted({kind for kinds in KINDS.values() for kind in kinds}))
def test_one_message_goes_wrong_and_the_arm_stops(world, kind, action):
    bench, proxy = world
    if kind not in KINDS[bench.control]:
        pytest.skip(f"{bench.control} sends no such message")
    chosen, way = KINDS[bench.control][kind]
    proxy.clear()
    bench.reset()
    bench.arm.move_jp(FAR)
    bench.until_moving(speed=0.5)
    proxy.spoil(action, chosen)
    with suppress(CrtkError):  # that is lost may be said; what counts is that the arm stops
        if way == "hold":
            bench.arm.hold()
        else:
            bench.arm.disable(timeout=LONG)
    eventually(proxy.hit.is_set, "the message")
    bench.until_still()
    assert bench.q()[0] < FAR[0] - 0.1, "it stopped on its way"
    assert bench.watch(0.3) < 1e-3, "nothing moves afterwards"
    bench.until_connected()
    eventually(lambda: moves_again(bench), "it moves again")


def moves_again(bench: UrBench) -> bool:
    """Enable and move; False where it is told only now that the program had been stopped."""
    if bench.status.state != "ENABLED":
        if bench.status.state == "DISABLED":
            bench.until_outputs(runtime_state=(STOPPED,))  # by the watchdog, where its link was cut
        with bench.nothing_moves():
            bench.enable()
    try:
        return bool(bench.arm.move_jr([-0.05, 0.0, 0.0, 0.0, 0.0, 0.0]).wait(LONG))
    except (CommandRefused, MotionAborted):
        if bench.status.state == "ENABLED":
            raise
        return False
