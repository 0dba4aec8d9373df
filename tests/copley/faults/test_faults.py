"""What goes wrong with drives, their axes and their line: told in words, and nothing moves on its own."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
import serial

from crtk_driver_copley.stream import Point
from crtk_drivers.errors import CommandRefused, CrtkError
from crtk_drivers.front import LocalDevice
from crtk_sim_backends.copley import RunningSim
from rigs.axes_bench import STEP, fault, stands, streamed
from rigs.copley_bench import ONE, PER_RADIAN, arm_at, drives, joints, moving, refused
from rigs.waiting import LONG, eventually

PROFILE = {"tracking": "profile"}


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with drives(travel=45_000, home_at=10_000) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """The drives, started anew, their axes at 0."""
    shared.control.clear()
    shared.control.call("place")
    yield shared
    shared.control.clear()


@pytest.mark.sweep(8)
@pytest.mark.parametrize(
    ("kind", "parameters", "words"),
    [
        ("foreign_stop", {}, "joint_1: its motion was ended, and not by this driver"),
        ("latch", {"node": 1, "bit": 7}, "joint_2: encoder error. Check the encoder"),
        ("latch", {"node": 2, "bit": 3}, "joint_3: drive too hot. Let it cool down"),
        ("input_off", {"node": 1}, "joint_2: its enable input is off. Close the enable input"),
        ("status", {"bits": 1 << 3}, "joint_1: under-voltage. Check the supply"),
        ("reset", {"node": 1}, "joint_2: it was disabled, or has been started anew"),
        ("refuses", {"text": "s r0x115", "code": 10}, "e 10 data value out of range. Check limits"),
        ("refuses", {"text": "g r0x32", "code": 32}, "e 32 CAN network communications failure"),
    ],
)
def test_a_fault_in_motion_is_told(
    sim: RunningSim, kind: str, parameters: dict[str, Any], words: str
) -> None:
    with moving(sim) as arm:
        sim.control.inject(kind, **parameters)
        fault(arm, words)
        eventually(lambda: stands(sim), "it stands")
        sim.control.clear()
        eventually(lambda: arm.engine.connected, "it is connected")
        arm.enable(LONG)
        assert arm.operating_state().state == "ENABLED"


@pytest.mark.slow
def test_a_blocked_axis_is_switched_off_by_its_drive(sim: RunningSim) -> None:
    with moving(sim, joints=joints(following_error=0.02)) as arm:
        sim.control.inject("blocked")
        fault(arm, "joint_1: following error. Is it blocked?")
        assert not sim.control.status()["on"][0]
        assert sim.control.status()["latched"][0] == 1 << 9
        sim.control.clear()
        arm.enable(LONG)
        assert sim.control.status()["latched"][0] == 0


@pytest.mark.slow
def test_a_following_error_limit_that_is_not_taken_is_refused(sim: RunningSim) -> None:
    sim.control.inject("deaf", text="s r0xba")
    refused(sim, "its following error limit (0xba) was set", joints=joints(following_error=0.02))


@pytest.mark.slow
def test_a_limit_switch_stops_the_axis_and_it_can_be_moved_away(sim: RunningSim) -> None:
    sim.control.call("place", counts=40_000)
    with moving(sim, 0.5, joints=ONE, limits={"max_step": 1.0}) as arm:
        fault(arm, "joint_1: it has met its positive limit switch")
        eventually(lambda: stands(sim), "it stands")
        assert sim.control.status()["position"][0] < 50_000
        eventually(lambda: arm.health().notes, "it is noted")
        assert any("positive limit switch" in note.text for note in arm.health().notes)
        arm.enable(LONG)
        goal = arm.measured_js().position.copy()
        goal[0] -= 0.5
        arm.move_jp(goal).wait(LONG)
        eventually(lambda: not any("limit" in n.text for n in arm.health().notes), "it is away")


def test_a_fault_that_cannot_be_cleared_is_told_by_enable(sim: RunningSim) -> None:
    with arm_at(sim) as arm:
        sim.control.inject("latch", bit=11)
        with pytest.raises(CrtkError, match="could not be cleared: joint_1: FPGA failure"):
            arm.enable(LONG)
        assert not any(sim.control.status()["on"])


@pytest.mark.slow
def test_latched_faults_are_cleared_by_enable_only(sim: RunningSim) -> None:
    sim.control.inject("latch", bit=7)
    with arm_at(sim) as arm:
        seen = arm.health().samples
        eventually(lambda: arm.health().samples > seen + 10, "it is looked at")
        assert sim.control.status()["latched"][0] == 1 << 7
        arm.enable(LONG)
        assert sim.control.status()["latched"][0] == 0


def test_power_that_is_not_read_back_is_not_believed(sim: RunningSim) -> None:
    with arm_at(sim) as arm:
        sim.control.inject("deaf", text="s r0x24")
        with pytest.raises(
            CrtkError, match=r"desired state \(0x24\) was set to 21: joint_1 tells 'v 0'"
        ):
            arm.enable(LONG)
        sim.control.clear()
        arm.enable(LONG)
        sim.control.inject("deaf", text="s r0x24")
        with pytest.raises(CrtkError, match=r"was set to 0: joint_1 tells 'v 21'"):
            arm.disable(LONG)


@pytest.mark.slow
def test_an_enable_input_that_is_off_is_told_by_enable(sim: RunningSim) -> None:
    sim.control.inject("input_off", node=2)
    with arm_at(sim) as arm, pytest.raises(CrtkError, match="joint_3: its enable input is off"):
        arm.enable(LONG)


def test_a_drive_that_starts_anew_in_motion_comes_back_at_its_rate_and_disabled(
    sim: RunningSim,
) -> None:
    with moving(sim, joints=joints(homing={"method": "here"})) as arm:
        arm.home(LONG)
        assert arm.is_homed()
        assert sim.control.status()["baud"] == 115200
        sim.control.inject("reset")
        assert sim.control.status()["baud"] == 9600
        eventually(lambda: arm.health().reconnects > 0 and arm.engine.connected, "it is back")
        eventually(lambda: arm.operating_state().state == "DISABLED", "it is DISABLED")
        eventually(lambda: not arm.is_homed(), "its home is forgotten")
        assert sim.control.status()["baud"] == 115200
        assert not sim.control.status()["on"][0]


@pytest.mark.slow
def test_home_is_remembered_by_drives_that_were_not_restarted(sim: RunningSim) -> None:
    keys = joints(homing={"method": "here"})
    with arm_at(sim, joints=keys) as arm:
        assert not arm.is_homed()
        arm.enable(LONG)
        arm.home(LONG)
    with arm_at(sim, joints=keys) as arm:
        assert arm.is_homed()
        arm.unhome(LONG)
        assert not arm.is_homed()


@pytest.mark.slow
def test_one_that_was_homed_before_and_does_not_begin_is_not_homed(sim: RunningSim) -> None:
    keys = joints(homing={"method": "switch_positive", "speed": 1.5, "slow": 0.5})
    with arm_at(sim, joints=keys) as arm:
        arm.enable(LONG)
        arm.home(LONG)
        arm.unhome(LONG)  # the drives count as homed all the same
        sim.control.inject("deaf", text="t 2")
        with pytest.raises(CrtkError, match="was not homed: it did not begin"):
            arm.home(LONG)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "place"),
    [("switch_positive", 10_000), ("index_negative", 0), ("limit_positive", 45_000)],
)
def test_homing_finds_what_it_looks_for(sim: RunningSim, method: str, place: int) -> None:
    homing = {"method": method, "speed": 1.5, "slow": 0.5}
    keys = {**joints(), "joint_1": {**ONE["joint_1"], "homing": homing, "offset": 0.5}}
    sim.control.call("place", counts=300)
    with arm_at(sim, joints=keys) as arm:
        arm.enable(LONG)
        arm.home(LONG)
        assert arm.is_homed()
        assert sim.control.status()["position"][0] == pytest.approx(place, abs=50)
        eventually(lambda: abs(arm.measured_js().position[0] - 0.5) < 5e-3, "it counts from there")
        assert arm.operating_state().state == "ENABLED"


@pytest.mark.slow
@pytest.mark.parametrize("place", [43_000, 43_500, 44_000])
def test_homing_leaves_it_where_it_was_homed(sim: RunningSim, place: int) -> None:
    """A position that was told before counts from another place: it would be the first setpoint."""
    homing = {"method": "limit_positive", "speed": 1.5, "slow": 0.5}
    sim.control.call("place", counts=place)
    with arm_at(sim, joints={"joint_1": {**ONE["joint_1"], "homing": homing}}) as arm:
        arm.enable(LONG)
        arm.home(LONG)
        assert arm.setpoint_js().position[0] == pytest.approx(0.0, abs=0.01)


def test_a_drive_that_is_not_heard_any_more_is_told_to_stop(sim: RunningSim) -> None:
    """It would home on by itself."""
    homing = {"method": "limit_positive", "speed": 0.2}
    with arm_at(sim, joints={"joint_1": {**ONE["joint_1"], "homing": homing}}) as arm:
        arm.enable(LONG)
        arm.engine.state_command("home")
        eventually(lambda: sim.control.status()["mode"][0] == "home", "it homes")
        sim.control.inject("mute", every=1)
        eventually(lambda: sim.control.status()["mode"][0] == "", "it has stopped")
        assert sim.control.status()["position"][0] < 40_000
        sim.control.clear()
        eventually(lambda: arm.engine.connected, "it is connected again")
        count = arm.health().samples
        eventually(lambda: arm.health().samples > count + 5, "it is seen to stand")


def test_a_fault_of_the_homing_axis_ends_it(sim: RunningSim) -> None:
    homing = {"method": "limit_positive", "speed": 0.2}
    with arm_at(sim, joints={"joint_1": {**ONE["joint_1"], "homing": homing}}) as arm:
        arm.enable(LONG)
        arm.engine.state_command("home")
        eventually(lambda: sim.control.status()["mode"][0] == "home", "it homes")
        sim.control.inject("status", bits=1 << 3)
        fault(arm, "joint_1: under-voltage. Check the supply")
        eventually(lambda: stands(sim), "it stands")
        assert not arm.is_homed()


@pytest.mark.slow
def test_homing_that_meets_a_limit_switch_fails_with_the_reason() -> None:
    keys = {"joint_1": {**ONE["joint_1"], "homing": {"method": "switch_positive", "speed": 1.5}}}
    with drives(travel=3000, home_at=20_000, nodes=1) as short, arm_at(short, joints=keys) as arm:
        arm.enable(LONG)
        with pytest.raises(CrtkError, match=r"joint_1 was not homed: it tells a homing error"):
            arm.home(LONG)
        assert not arm.is_homed()


@pytest.mark.slow
def test_a_stop_that_does_nothing_is_not_believed(sim: RunningSim) -> None:
    """The points run out, and it rests: but it was not the stop that did it, and it is told late."""
    with arm_at(sim, tracking="profile") as arm:
        arm.enable(LONG)
        sim.control.inject("deaf", text="t 0")
        move = arm.move_jp(arm.measured_js().position + 2.0)
        eventually(lambda: arm.measured_js().velocity[0] > 0.1, "it moves")
        arm.hold()
        with pytest.raises(CrtkError):
            move.wait(LONG)
        sim.control.clear()
        eventually(lambda: arm.engine.device.has_stopped, "it is read back when it is carried out")


@pytest.mark.slow  # on a busy machine an answer that is late comes on top, and two in a row are a fault
@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("lost", {"every": 23}),
        ("mute", {"every": 23}),
        ("half_line", {"every": 19}),
        ("corrupt", {"every": 17}),
        ("garbled", {"every": 19}),
        ("doubled", {"every": 7}),
        ("garbage", {"every": 13}),
        ("late", {"every": 29, "seconds": 0.1}),
    ],
)
def test_what_is_only_now_and_then_is_counted_and_lived_with(
    sim: RunningSim, kind: str, parameters: dict[str, Any]
) -> None:
    """A point whose answer does not come is looked for in the buffer, and sent once."""
    with arm_at(sim, reply_timeout=0.06, pvt_lead=12, pvt_period=0.05, joints=ONE) as arm:
        arm.enable(LONG)
        arm.move_jp(arm.measured_js().position + 0.05).wait(LONG)
        sim.control.inject(kind, **parameters)
        goal = arm.measured_js().position + 0.2
        arm.move_jp(goal).wait(LONG)
        assert arm.operating_state().state == "ENABLED"
        assert arm.health().device["doubted answers"] > 0
        eventually(lambda: np.abs(arm.measured_js().position - goal).max() < 2e-3, "it is there")
        sim.control.clear()


def points_of(arm: LocalDevice) -> list[int]:
    """Return a list that will hold where the points of the first axis are, since its stream last began."""
    stream = arm.engine.device._controller._tracking._stream  # type: ignore[attr-defined]
    stand, row = stream.stand, stream._row
    places: list[int] = []

    def stands_first(here: list[int]) -> list[list[Point]]:
        rows: list[list[Point]] = stand(here)
        places[:] = [points[0].position for points in rows]
        return rows

    def goes_on(end: float) -> list[Point]:
        points: list[Point] = row(end)
        places.append(points[0].position)
        return points

    stream.stand, stream._row = stands_first, goes_on
    return places


@pytest.mark.sweep(10)
@pytest.mark.parametrize("kind", ["lost_once", "mute_once"])
@pytest.mark.parametrize(
    ("text", "since"),
    [("s r0x115", 0.0), ("s r0x115 30 0", 0.0), ("t 1", 0.0), ("s r0x115", 0.6), ("g r0x115", 0.6)],
)
def test_one_line_that_is_lost_lets_no_axis_run_away(
    sim: RunningSim, kind: str, text: str, since: float
) -> None:
    """When it begins, or in motion: it goes on as it should, or stands."""
    with arm_at(sim, reply_timeout=0.03, pvt_lead=8, joints=ONE) as arm:
        arm.enable(LONG)
        sent = points_of(arm)
        goal, begun, injected = arm.measured_js().position.copy(), time.monotonic(), False
        doubted = lambda: arm.health().device["doubted answers"] > 0  # noqa: E731
        while arm.operating_state().state == "ENABLED" and (
            time.monotonic() < begun + since + 0.8 or not doubted()
        ):
            assert time.monotonic() < begun + LONG, "never: it is lost"
            if not injected and time.monotonic() > begun + since:
                injected = True
                sim.control.inject(kind, text=text)
            goal[0] += 0.5 * STEP
            with suppress(CommandRefused):  # it may have come to FAULT just now
                goal = streamed(arm, goal)
            time.sleep(STEP)
        assert doubted()
        with suppress(CommandRefused):
            arm.hold()
        eventually(lambda: stands(sim), "it stands")
        taken = sim.control.call("points", node=0)
        assert len(taken) > 8
        assert taken == sent[: len(taken)], "each point once, and none is missing"


def test_a_stop_whose_line_is_lost_is_sent_again(sim: RunningSim) -> None:
    with moving(sim) as arm:
        sim.control.inject("lost_once", text="t 0")
        arm.hold()
        eventually(lambda: arm.engine.device.has_stopped, "it is read back")


@pytest.mark.slow
def test_a_point_with_another_digit_is_ended_by_the_drive(sim: RunningSim) -> None:
    """Lines have no check sum: its following error limit is what tells, soon."""
    keys = {"joint_1": {**ONE["joint_1"], "following_error": 0.1}}
    with moving(sim, 0.1, joints=keys) as arm:
        sim.control.inject("wrong_digit")
        fault(arm, "joint_1")
        eventually(lambda: stands(sim), "it stands")
        assert abs(sim.control.status()["position"][0]) < 1.0 * PER_RADIAN


def test_a_stream_begins_where_two_answers_say_that_it_stands(sim: RunningSim) -> None:
    sim.control.inject("wrong_answer", text="g r0x2d")
    with arm_at(sim, joints=ONE) as arm:
        arm.enable(LONG)
        goal = arm.measured_js().position.copy()
        seen = []

        def is_seen() -> bool:
            arm.servo_jp(goal)
            status = sim.control.status()
            seen.extend(status["position"][:1] if status["mode"][0] == "pvt" else [])
            return len(seen) > 50

        eventually(is_seen, "it follows")
        assert max(map(abs, seen)) < 50.0


@pytest.mark.slow
def test_points_that_do_not_come_stop_the_axes(sim: RunningSim) -> None:
    with moving(sim, sample_timeout=0.4) as arm:
        sim.control.inject("silence", port="serial")
        eventually(lambda: stands(sim), "it stands")
        eventually(lambda: arm.operating_state().state == "FAULT", "it is in FAULT")
        sim.control.clear()
        eventually(lambda: arm.operating_state().state == "DISABLED", "it is back")


@pytest.mark.parametrize("late", [0.012, 0.03])
@pytest.mark.parametrize("command", ["move_jp", "servo_jv"])
def test_a_line_that_is_too_slow_is_named(sim: RunningSim, command: str, late: float) -> None:
    with arm_at(sim, pvt_period=0.04, pvt_lead=6, sample_timeout=3.0) as arm:
        arm.enable(LONG)
        sim.control.inject("late", every=1, seconds=late)
        move = arm.move_jp([2.0, 0.0, 0.0]) if command == "move_jp" else None
        while arm.operating_state().state == "ENABLED" and move is None:
            with suppress(CommandRefused):
                arm.servo_jv([0.5, 0.0, 0.0])
            time.sleep(STEP)
        fault(arm, "the line is too slow: an answer takes")
        assert move is None or (move.outcome == "aborted" and "pvt_period" in str(move.reason))
        told = [note.text for note in arm.health().notes if note.key == "slow line"]
        assert "Give a longer pvt_period" in told[0]


def test_a_node_that_is_gone_is_told_with_its_remedy(sim: RunningSim) -> None:
    sim.control.inject("node_gone", node=2)
    refused(sim, "joint_3: it does not tell 0xa0 (status): e 32 CAN network communications failure")


@pytest.mark.slow
def test_an_adapter_that_is_pulled_out_is_found_again(sim: RunningSim) -> None:
    with moving(sim) as arm:
        sim.control.inject("disconnect", port="serial")
        fault(arm, "the adapter is gone")
        eventually(lambda: stands(sim), "it stands")
        sim.control.clear()
        eventually(lambda: arm.operating_state().state == "DISABLED", "it is back")
        assert arm.operating_state().detail.endswith("has power")


@pytest.mark.slow
def test_an_echo_is_understood_and_told() -> None:
    with drives(echo=True, nodes=1) as sim, arm_at(sim, joints=ONE) as arm:
        arm.enable(LONG)
        arm.move_jp([0.1]).wait(LONG)
        assert arm.health().device["echoes"] > 10
        assert any(note.key == "echo" for note in arm.health().notes)


def test_a_second_program_is_kept_out(sim: RunningSim) -> None:
    with arm_at(sim):
        refused(sim, "in use")


@pytest.mark.slow
def test_one_that_opens_the_line_all_the_same_is_noticed_and_survived(sim: RunningSim) -> None:
    """It takes answers away, its own are one too many, and it sets the port to its liking."""

    def is_noticed() -> bool:
        return arm.health().device["doubted answers"] > 0 or arm.health().reconnects > 0

    with arm_at(sim, reply_timeout=0.03, joints=ONE) as arm:
        arm.enable(LONG)
        with serial.Serial(sim.ttys["serial"], 115200, timeout=0.0) as other:
            while not is_noticed():
                other.write(b"g r0x32\r")
                time.sleep(STEP)
        eventually(
            lambda: arm.operating_state().state in ("ENABLED", "DISABLED"), "it has its line"
        )


@pytest.mark.slow
def test_firmware_without_points_is_refused_unless_by_profiles() -> None:
    with drives(firmware=0x0010, nodes=1) as sim:
        refused(sim, "it does not tell 0x115 (pvt): e 9 unknown parameter", joints=ONE)
        with arm_at(sim, joints=ONE, **PROFILE) as arm:
            arm.enable(LONG)
            arm.move_jp([0.1]).wait(LONG)
            assert any(note.text == "0.16" for note in arm.health().notes)


@pytest.mark.slow
def test_through_a_server_nothing_is_said_of_the_rate(sim: RunningSim) -> None:
    """The drive is at 9600, and so is the server."""
    from crtk_driver_copley import PLUGIN
    from crtk_drivers.session import Session
    from rigs.copley_bench import configuration

    place = f"socket://{sim.host}:{sim.ports['server']}"
    config = configuration(sim, baud=9600, joints=ONE, pvt_period=0.1).model_copy(
        update={"port": place}
    )
    arm = LocalDevice(Session(PLUGIN, config))
    try:
        arm._session.start()
        eventually(lambda: arm.engine.has_sample, "it is connected")
        arm.enable(LONG)
        arm.move_jp([0.1]).wait(LONG)
        assert sim.control.status()["baud"] == 9600
    finally:
        arm.close()


def raw(sim: RunningSim, *commands: str) -> None:
    """Another program says something at 9600 bit/s, and all of it is taken."""
    with serial.Serial(sim.ttys["serial"], 9600, timeout=LONG) as other:
        for command in commands:
            other.write(f"{command}\r".encode())
            assert other.read_until(b"\r") == b"ok\r"


def test_nothing_moves_by_enable_though_points_were_left(sim: RunningSim) -> None:
    raw(sim, "s r0xc8 3", "s r0x115 50 0 0", "s r0x115 50 5000 0", "s r0xca 9000")
    with arm_at(sim) as arm:
        arm.enable(LONG)
        seen = arm.health().samples
        eventually(lambda: arm.health().samples > seen + 10, "it is looked at")
        assert abs(sim.control.status()["reference"][0]) < 1.0
        assert sim.control.status()["points"][0] == 0


@pytest.mark.slow
def test_drives_that_were_only_looked_at_keep_their_power(sim: RunningSim) -> None:
    raw(sim, "s r0x24 21")
    with arm_at(sim) as arm:
        assert arm.operating_state().detail == "joint_1 has power"
    assert sim.control.status()["on"][0]
    with arm_at(sim) as arm:
        arm.enable(LONG)
    eventually(lambda: not any(sim.control.status()["on"]), "what it switched on is off")


@pytest.mark.slow
def test_velocities_are_as_asked_and_end_with_their_stream(sim: RunningSim) -> None:
    with arm_at(sim) as arm:
        arm.enable(LONG)

        def is_as_asked() -> bool:
            arm.servo_jv([0.3, 0.0, 0.0])
            return abs(arm.measured_js().velocity[0] - 0.3) < 0.01

        for _ in range(20):
            eventually(is_as_asked, "it is as fast as asked")
        eventually(lambda: stands(sim), "it stands when no more comes")


@pytest.mark.slow
@pytest.mark.parametrize("tracking", ["pvt", "profile", "stop_go"])
def test_each_way_of_tracking_arrives(sim: RunningSim, tracking: str) -> None:
    with arm_at(sim, tracking=tracking) as arm:
        arm.enable(LONG)
        goal = arm.measured_js().position + 0.1
        arm.move_jp(goal).wait(LONG)
        eventually(lambda: np.abs(arm.measured_js().position - goal).max() < 2e-3, "it is there")
        assert arm.operating_state().state == "ENABLED"


@pytest.mark.slow
def test_efforts_are_those_of_the_current(sim: RunningSim) -> None:
    with arm_at(sim, joints=joints(torque_per_ampere=0.5)) as arm:
        arm.enable(LONG)
        move = arm.move_jp(arm.measured_js().position + 0.5)
        eventually(lambda: arm.measured_js().effort[0] > 0.0, "it pushes")
        move.wait(LONG)
