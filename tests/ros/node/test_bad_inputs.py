"""Bad inputs over real topics: each is refused with its reason, nothing is sent, the node goes on.

Each has the number that it has in the project's list of bad inputs (I1 to I20).
"""

from __future__ import annotations

import json
import math
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from crtk_msgs.msg import StringStamped
from crtk_msgs.srv import QueryForwardKinematics, QueryInverseKinematics
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from rigs.loopback_node import Rig, rig_of, slowly
from rigs.waiting import eventually

NAN, INF = math.nan, math.inf

HEADER_ONLY = bytes.fromhex("00010000 00000000 00000000 01000000 00000000")
"""A message up to the end of its header: little-endian, stamp 0, an empty frame."""


def joints(*position: float, **fields: Any) -> JointState:
    return JointState(position=list(position), **fields)


def pose(
    x: float = 0.01, quaternion: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0), frame: str = ""
) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x = x
    q = message.pose.orientation
    q.x, q.y, q.z, q.w = quaternion
    return message


def twist(x: float) -> TwistStamped:
    message = TwistStamped()
    message.twist.linear.x = x
    return message


def aged(seconds: float) -> JointState:
    message = joints(0.01, 0.0, 0.0, 0.0)
    stamp = time.time() - seconds
    message.header.stamp.sec = int(stamp)
    return message


def refusals(rig: Rig) -> dict[tuple[str, str], int]:
    """Return what the health counts, which is complete where the topic is throttled."""
    counted = rig.session.engine.health().refusals
    pairs = (key.split(": ") for key in counted)
    return {(name, reason): counted[f"{name}: {reason}"] for name, reason in pairs}


def told(rig: Rig, command: str, reason: str, since: int) -> dict[str, Any]:
    """Wait for a refusal on the topic and return it."""

    def is_it(message: Any) -> bool:
        content = json.loads(message.data)
        return bool(content["command"] == command and content["reason"] == reason)

    content: dict[str, Any] = json.loads(rig.client["refusals"].wait(is_it, since).data)
    return content


def assert_alive(rig: Rig) -> None:
    """A good command is executed."""
    rig.client.state_command("resume" if rig.client.state.state == "PAUSED" else "enable")
    rig.client["operating_state"].wait(
        lambda m: m.state == "ENABLED", rig.client["operating_state"].mark()
    )
    rig.client.move("move_jp", joints(0.0, 0.02, 0.0, 0.0))
    rig.client["measured_js"].wait(
        lambda m: abs(m.position[1] - 0.02) < 1e-3, rig.client["measured_js"].mark()
    )


ENABLED_CASES = [
    ("I1 NaN", "servo_jp", joints(0.0, NAN, 0.0, 0.0), "not_finite"),
    ("I1 infinite", "servo_jv", JointState(velocity=[0.0, INF, 0.0, 0.0]), "not_finite"),
    ("I1 pose", "servo_cp", pose(NAN), "not_finite"),
    ("I1 quaternion", "move_cp", pose(0.0, (0.0, NAN, 0.0, 1.0)), "not_finite"),
    ("I1 twist", "servo_cv", twist(-INF), "not_finite"),
    ("I2 too few", "servo_jp", joints(0.0, 0.0, 0.0), "wrong_size"),
    ("I2 too many", "move_jp", joints(0.0, 0.0, 0.0, 0.0, 0.0), "wrong_size"),
    ("I2 unlike sizes", "servo_jp", joints(0.0, 0.0, 0.0, 0.0, velocity=[0.0]), "wrong_size"),
    ("I3 empty", "servo_jp", JointState(velocity=[0.0] * 4), "empty"),
    ("I3 effort", "servo_jf", joints(0.0, 0.0, 0.0, 0.0), "empty"),
    ("I4 unknown", "servo_jp", joints(0, 0, 0, 0, name=["x", "y", "z", "w"]), "wrong_names"),
    ("I4 twice", "servo_jp", joints(0, 0, 0, 0, name=["x", "x", "z", "yaw"]), "wrong_names"),
    ("I4 partial", "servo_jp", joints(0, 0, name=["x", "y"]), "wrong_size"),
    ("I6 zero", "servo_cp", pose(0.01, (0.0, 0.0, 0.0, 0.0)), "bad_quaternion"),
    ("I7 norm", "servo_cp", pose(0.01, (0.0, 0.0, 0.0, 1.01)), "bad_quaternion"),
    ("I8 move", "move_jp", joints(5.0, 0.0, 0.0, 0.0), "out_of_range"),
    ("I8 increment", "servo_cr", pose(1e308), "out_of_range"),
    ("I8 slow increment", "interpolate_cr", pose(-1e308), "out_of_range"),
    ("I8 far", "move_cp", pose(1e308), "out_of_range"),
    ("I8 twist", "body/servo_cv", twist(1e308), "out_of_range"),
    ("I2 very many", "servo_jp", joints(*[0.0] * 100_000), "wrong_size"),
    ("I9 jump", "servo_jp", joints(0.5, 0.0, 0.0, 0.0), "step_too_large"),
    ("I10 frame", "servo_cp", pose(frame="moon"), "wrong_frame"),
    ("I10 long", "move_cp", pose(frame="m" * 10_000), "wrong_frame"),
    ("unreachable", "move_cp", pose(0.0, (1.0, 0.0, 0.0, 0.0)), "unreachable"),
]


def raw(message: Any, change: Callable[[bytes], bytes]) -> bytes:
    return change(serialize_message(message))


MALFORMED_CASES = {
    "cut off": ("servo_jp", raw(joints(0.0, 0.0, 0.0, 0.0), lambda data: data[:-9])),
    "no more than a header": ("servo_cp", raw(pose(), lambda data: data[:28])),
    "nothing": ("servo_jp", b""),
    "too long": ("servo_cv", raw(twist(0.01), lambda data: data + bytes(64))),
    "XCDR2": ("servo_jp", raw(joints(0.0), lambda data: b"\0\x07" + data[2:])),
    "2^31 positions": ("move_jp", HEADER_ONLY + bytes(4) + (1 << 31).to_bytes(4, "little")),
    "2^32 - 1 names": ("move_jp", HEADER_ONLY + b"\xff" * 4),
    "a twist for a pose": ("servo_cp", serialize_message(twist(0.01))),
    "no UTF-8": ("state_command", HEADER_ONLY + b"\3\0\0\0\xc3\x28\0"),
}


@pytest.mark.parametrize(("command", "data"), MALFORMED_CASES.values(), ids=list(MALFORMED_CASES))
def test_bytes_that_are_no_such_message_are_refused(rig: Rig, command: str, data: bytes) -> None:
    rig.client.reach("enable", "ENABLED")
    writes, key = rig.device.writes, (command, "wrong_type")
    before = refusals(rig).get(key, 0)
    since = rig.client["refusals"].mark()
    rig.client.send(command, data)
    content = told(rig, command, "wrong_type", since)
    assert "this is no" in content["message"]
    assert refusals(rig)[key] == before + 1
    assert rig.device.writes == writes
    assert_alive(rig)


def test_a_state_command_is_carried_out_whatever_stands_behind_it(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    since = rig.client["operating_state"].mark()
    rig.client.send("state_command", serialize_message(StringStamped(string="disable")) + bytes(64))
    rig.client["operating_state"].wait(lambda m: m.state == "DISABLED", since)


def text_after(header: bytes, text: bytes) -> bytes:
    """Return a state command whose header is `header`, from behind its stamp."""
    begun = HEADER_ONLY[:12] + header
    return begun + bytes(-len(begun) % 4) + struct.pack("<I", len(text)) + text


DAMAGED_HEADERS = {
    "no UTF-8": b"\3\0\0\0\xc3\x28\0",
    "a zero": b"\4\0\0\0a\0b\0",
    "a count beyond the end": b"\xff\xff\xff\x7f",
    "no frame": b"",
}
DAMAGED_STOPS = {
    **{
        f"{why}, {word}": (word, text_after(header, word.encode() + b"\0"))
        for why, header in DAMAGED_HEADERS.items()
        for word in ("disable", "pause")
    },
    "zeros behind it": ("disable", text_after(HEADER_ONLY[12:], b"disable\0\0\0")),
    "garbage behind it": ("pause", text_after(HEADER_ONLY[12:], b"pause\0\xff\xfe")),
    "its last byte is missing": ("disable", text_after(HEADER_ONLY[12:], b"disable\0")[:-1]),
    "XCDR2": ("disable", b"\0\x07" + text_after(HEADER_ONLY[12:], b"disable\0")[2:]),
    "no header at all": ("pause", b"\0\1\0\0\6\0\0\0pause\0"),
    "the stop is last": ("disable", text_after(b"\6\0\0\0pause\xff", b"disable\0")),
}


@pytest.mark.parametrize(("word", "data"), DAMAGED_STOPS.values(), ids=list(DAMAGED_STOPS))
def test_a_stop_is_taken_from_a_damaged_message(rig: Rig, word: str, data: bytes) -> None:
    rig.client.reach("enable", "ENABLED")
    since = rig.client["operating_state"].mark()
    rig.client.send("state_command", data)
    reached = "DISABLED" if word == "disable" else "PAUSED"
    rig.client["operating_state"].wait(lambda m: m.state == reached, since)


@pytest.mark.parametrize("data", [b"", b"\0", b"\xff\xff"])
def test_hold_is_taken_whatever_its_bytes_are(rig: Rig, data: bytes) -> None:
    rig.client.reach("enable", "ENABLED")
    engine = rig.session.engine
    with slowly(engine):
        rig.client.send("move_jp", joints(0.5, 0.0, 0.0, 0.0))
        eventually(lambda: engine.status.is_busy, "the move has begun")
        rig.client.send("hold", data)
        eventually(lambda: not engine.status.is_busy, "the move has ended")
    assert rig.client["measured_js"].messages[-1].position[0] < 0.4


@pytest.mark.parametrize("header", DAMAGED_HEADERS.values(), ids=list(DAMAGED_HEADERS))
def test_a_damaged_message_enables_nothing(rig: Rig, header: bytes) -> None:
    since = rig.client["refusals"].mark()
    rig.client.send("state_command", text_after(header, b"enable\0"))
    told(rig, "state_command", "wrong_type", since)
    assert rig.session.engine.status.state == "DISABLED"


def test_a_stamp_that_is_none_silences_nothing(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    message = joints(0.0, 0.0, 0.0, 0.0)
    message.header.stamp.sec, message.header.stamp.nanosec = 2**31 - 1, 2**32 - 1

    def streams() -> bool:  # a stream of one command is soon over
        rig.client.send("servo_jp", message)
        return rig.session.engine.health().stream == "servo_jp"

    eventually(streams, "the command is carried out")
    for name in ("setpoint_js", "setpoint_cp", "measured_js"):
        inbox = rig.client[name]
        inbox.wait(since=inbox.mark() + 3)


def test_a_big_endian_command_is_carried_out(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    position = struct.pack(">4d", 0.0, 0.03, 0.0, 0.0)
    header = b"\0\0\0\0" + bytes(8) + struct.pack(">I", 1) + bytes(4)
    data = header + bytes(4) + struct.pack(">I", 4) + position + bytes(8)
    rig.client.move("move_jp", data)
    rig.client["measured_js"].wait(
        lambda m: abs(m.position[1] - 0.03) < 1e-3, rig.client["measured_js"].mark()
    )


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("command", "message", "reason"),
    [case[1:] for case in ENABLED_CASES],
    ids=[case[0] for case in ENABLED_CASES],
)
def test_refused_while_enabled(rig: Rig, command: str, message: Any, reason: str) -> None:
    rig.client.reach("enable", "ENABLED")
    writes, before = rig.device.writes, refusals(rig).get((command, reason), 0)
    rig.client.send(command, message)
    eventually(lambda: refusals(rig).get((command, reason), 0) > before, "it is counted")
    content = told(rig, command, reason, 0)
    assert content["message"]
    assert content["remedy"]
    # two cycles later nothing has been written
    cycles = rig.session.engine.health().cycles
    eventually(lambda: rig.session.engine.health().cycles > cycles + 2, "two more cycles")
    assert rig.device.writes == writes
    assert rig.client.state.state == "ENABLED"
    assert_alive(rig)


def test_names_may_be_permuted_or_left_out(rig: Rig) -> None:
    """I4, I5."""
    rig.client.reach("enable", "ENABLED")
    rig.client.move("move_jp", joints(0.4, 0.3, 0.2, 0.1, name=["yaw", "z", "y", "x"]))
    goal = rig.client["goal_js"].wait(lambda m: m.position[0] == 0.1)
    assert list(goal.position) == [0.1, 0.2, 0.3, 0.4]
    rig.client.move("move_jp", joints(0.1, 0.2, 0.3, 0.3))
    assert rig.client["goal_js"].wait(lambda m: m.position[3] == 0.3)


def test_quaternion_nearly_of_unit_length_is_accepted(rig: Rig) -> None:
    """I7."""
    rig.client.reach("enable", "ENABLED")
    rig.client.move("move_cp", pose(0.03, (0.0, 0.0, 0.0, 1.0005)))
    goal = rig.client["goal_cp"].wait(lambda m: m.pose.position.x == 0.03)
    assert goal.pose.orientation.w == pytest.approx(1.0, abs=1e-12)


def test_frame_of_measured_cp_is_accepted(rig: Rig) -> None:
    """I10: rqt copies the frame of what is measured."""
    rig.client.reach("enable", "ENABLED")
    frame = rig.client["measured_cp"].wait().header.frame_id
    rig.client.move("move_cp", pose(0.04, frame=frame))
    assert rig.client["goal_cp"].wait(lambda m: m.pose.position.x == 0.04)


NOT_ENABLED = ["DISABLED", "PAUSED", "FAULT"]


@pytest.mark.parametrize("state", NOT_ENABLED)
@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("servo_jp", joints(0.0, 0.0, 0.0, 0.0)),
        ("servo_jr", joints(0.001, 0.0, 0.0, 0.0)),
        ("servo_cv", twist(0.01)),
        ("move_jp", joints(0.0, 0.0, 0.0, 0.0)),
        ("move_cp", pose()),
        ("free", Empty()),
    ],
)
def test_nothing_moves_unless_enabled(rig: Rig, state: str, command: str, message: Any) -> None:
    """I12."""
    if state == "PAUSED":
        rig.client.reach("enable", "ENABLED")
        rig.client.reach("pause", "PAUSED")
    if state == "FAULT":
        rig.device.reachable = False
    eventually(lambda: rig.session.engine.status.state == state, f"the device is in {state}")
    writes, before = rig.device.writes, refusals(rig).get((command, "not_enabled"), 0)
    rig.client.send(command, message)
    eventually(lambda: refusals(rig).get((command, "not_enabled"), 0) > before, "it is counted")
    assert told(rig, command, "not_enabled", 0)["remedy"]
    assert rig.device.writes == writes


@pytest.mark.parametrize("text", ["Enable", "enable ", "", "stand up", "x" * 10_000])
def test_unknown_state_command(rig: Rig, text: str) -> None:
    """I13: exact match only, and the remedy lists what is valid."""
    before = refusals(rig).get(("state_command", "unknown_command"), 0)
    rig.client.send("state_command", StringStamped(string=text))
    eventually(
        lambda: refusals(rig).get(("state_command", "unknown_command"), 0) > before,
        "it is counted",
    )
    content = told(rig, "state_command", "unknown_command", 0)
    assert "enable, disable, pause, resume, home, unhome" in content["remedy"]
    assert len(content["message"]) < 200
    assert rig.client.state.state == "DISABLED"


def test_a_refused_state_command_is_told_with_its_stamp(rig: Rig) -> None:
    message = StringStamped(string="unhome")
    message.header.stamp.sec, message.header.stamp.nanosec = 1_763_700_000, 7
    rig.client.send("state_command", message)
    content = told(rig, "state_command", "no_effect", 0)
    assert content["stamp"] == {"sec": 1_763_700_000, "nanosec": 7}
    assert content["state_command"] == "unhome"
    assert "is_homed stays true" in content["remedy"]


def test_invalid_transition(rig: Rig) -> None:
    before = refusals(rig).get(("state_command", "invalid_transition"), 0)
    rig.client.state_command("resume")
    eventually(
        lambda: refusals(rig).get(("state_command", "invalid_transition"), 0) > before,
        "it is counted",
    )
    assert rig.client.state.state == "DISABLED"


@pytest.mark.real_time  # how much a real machine can take
def test_flood_is_survived_and_the_newest_wins(rig: Rig) -> None:
    """I14."""
    rig.client.reach("enable", "ENABLED")
    message = joints(0.0, 0.0, 0.0, 0.0)
    end = time.monotonic() + 1.0
    sent = 0
    while time.monotonic() < end or sent <= 1000:
        message.position[0] = 0.01 * (time.monotonic() % 1.0)
        rig.client.send("servo_jp", message)
        sent += 1
    cycles = rig.session.engine.health().cycles
    writes = rig.device.writes
    message.position[0] = 0.02

    def arrived() -> bool:
        rig.client.send("servo_jp", message)
        setpoint = rig.device.last_setpoint
        return setpoint is not None and setpoint.values[0] == 0.02

    eventually(arrived, "the newest command is the setpoint")
    assert rig.session.engine.health().cycles >= cycles
    assert rig.device.writes - writes < sent // 2, "a backlog was worked off"


def test_flood_of_refused_moves_keeps_pulse_and_rate(rig: Rig) -> None:
    """I15: the busy pulse arrives, and operating_state stays far below what breaks the client."""
    since = rig.client["operating_state"].mark()
    start = time.monotonic()
    while time.monotonic() < start + 2.0:
        rig.client.send("move_jp", joints(0.0))
        time.sleep(0.001)
    rig.client.wait_for_busy(since)
    messages = rig.client["operating_state"].mark() - since
    elapsed = time.monotonic() - start
    assert messages < 10 + 30 * elapsed
    states = rig.client["operating_state"].messages
    eventually(lambda: not any(m.is_busy for m in states[-2:]), "busy has fallen and stays so")
    heard = rig.client["refusals"].messages

    def count() -> int:  # some may still be on their way
        return refusals(rig)["move_jp", "not_enabled"]

    assert told(rig, "move_jp", "not_enabled", 0)["count"] <= count()
    eventually(
        lambda: any(json.loads(m.data)["count"] == count() for m in heard),
        "the last count is told when the interval is over",
    )


def test_move_during_homing(rig: Rig) -> None:
    """I15: a move waits for the end of homing, and hold ends both; a stream is refused."""
    with rig_of("/homing", needs_homing=True) as slow:
        slow.client.reach("enable", "ENABLED")
        slow.device.transition_time = 4.0
        inbox = slow.client["operating_state"]

        def home_and_move() -> int:
            since = inbox.mark()
            slow.client.state_command("home")
            begun = inbox.messages.index(inbox.wait(lambda m: m.is_busy, since))
            slow.client.send("move_jp", joints(0.02, 0.0, 0.0, 0.0))
            eventually(lambda: slow.session.engine._board.move_waits, "the move waits")
            return begun

        home_and_move()
        slow.client.send("hold", Empty())
        inbox.wait(lambda m: not m.is_busy, inbox.mark())
        begun = home_and_move()
        assert slow.device.writes == 0, "hold has ended the move"
        slow.device.transition_time = 0.0
        inbox.wait(lambda m: m.is_homed and m.is_busy, begun)
        inbox.wait(lambda m: not m.is_busy, begun)
        setpoints = slow.client["setpoint_js"].messages
        eventually(lambda: max(setpoints[-1].position, default=0.0) > 0.019, "it is there")
        slow.client.state_command("unhome")
        inbox.wait(lambda m: not m.is_homed, inbox.mark())
        since = inbox.mark()
        slow.device.transition_time = 4.0
        slow.client.state_command("home")
        inbox.wait(lambda m: m.is_busy, since)
        slow.client.send("servo_jp", joints(0.02, 0.0, 0.0, 0.0))
        assert told(slow, "servo_jp", "transition_running", 0)["remedy"]


def test_two_clients_of_different_kinds(rig: Rig) -> None:
    """I16: the running stream goes on, the other is refused until the first has ended."""
    rig.client.reach("enable", "ENABLED")
    before = refusals(rig).get(("servo_jf", "mode_switch"), 0)

    def both() -> bool:
        rig.client.send("servo_jp", joints(0.001, 0.0, 0.0, 0.0))
        if rig.session.engine.health().stream == "servo_jp":  # else servo_jf might be the first
            rig.client.send("servo_jf", JointState(effort=[0.0, 0.0, 0.0, 0.0]))
        return refusals(rig).get(("servo_jf", "mode_switch"), 0) > before + 3

    eventually(both, "servo_jf is refused")

    def positions() -> bool:
        rig.client.send("servo_jp", joints(0.001, 0.0, 0.0, 0.0))
        setpoint = rig.device.last_setpoint
        return setpoint is not None and setpoint.mode == "joint position"

    eventually(positions, "servo_jp goes on")


@pytest.fixture(scope="module")
def strict_rig() -> Iterator[Rig]:
    with rig_of("/strict", limits={"max_command_age": 1.0}) as rig:
        rig.client.reach("enable", "ENABLED")
        yield rig


@pytest.mark.parametrize(("seconds", "reason"), [(30.0, "too_old"), (-30.0, "from_future")])
def test_age_of_commands(strict_rig: Rig, seconds: float, reason: str) -> None:
    """I11, which is off by default."""
    writes = strict_rig.device.writes
    strict_rig.client.send("servo_jp", aged(seconds))
    assert told(strict_rig, "servo_jp", reason, 0)
    assert strict_rig.device.writes == writes
    strict_rig.client.send("servo_jp", joints(0.0, 0.0, 0.0, 0.0))  # no stamp: now
    eventually(lambda: strict_rig.device.writes > writes, "an unstamped command is executed")


def state_aged(text: str, seconds: float) -> StringStamped:
    message = StringStamped(string=text)
    message.header.stamp.sec = int(time.time() - seconds)
    return message


@pytest.mark.parametrize("text", ["enable", "resume", "home"])
def test_age_of_what_sets_the_device_going(strict_rig: Rig, text: str) -> None:
    """I11: an `enable` of an hour ago enables nothing."""
    since = strict_rig.client["refusals"].mark()
    strict_rig.client.send(
        "state_command", state_aged("disable", 3600.0)
    )  # a stop is never too old
    eventually(
        lambda: strict_rig.session.engine.status.state == "DISABLED", "disable is carried out"
    )
    strict_rig.client.send("state_command", state_aged(text, 3600.0))
    assert told(strict_rig, "state_command", "too_old", since)
    assert strict_rig.session.engine.status.state == "DISABLED"
    strict_rig.client.reach("enable", "ENABLED")
    strict_rig.client.send("state_command", state_aged("pause", 3600.0))
    eventually(lambda: strict_rig.session.engine.status.state == "PAUSED", "pause is carried out")
    strict_rig.client.reach("resume", "ENABLED")


QUERIES = [
    ("forward_kinematics", QueryForwardKinematics.Request(jp=[0.0] * 3), "wrong_size"),
    ("forward_kinematics", QueryForwardKinematics.Request(jp=[NAN] * 4), "not_finite"),
    ("inverse_kinematics", QueryInverseKinematics.Request(cp=pose().pose, jp=[0.0]), "wrong_size"),
    (
        "inverse_kinematics",
        QueryInverseKinematics.Request(cp=pose(0.0, (0.0, 0.0, 0.0, 0.0)).pose),
        "bad_quaternion",
    ),
    (
        "inverse_kinematics",
        QueryInverseKinematics.Request(cp=pose(0.0, (1.0, 0.0, 0.0, 0.0)).pose),
        "z only",
    ),
]


@pytest.mark.parametrize(("name", "request_", "why"), QUERIES)
def test_bad_queries(rig: Rig, name: str, request_: Any, why: str) -> None:
    """I20."""
    response = rig.client.call(name, request_)
    assert response.result is False
    assert why in response.message
