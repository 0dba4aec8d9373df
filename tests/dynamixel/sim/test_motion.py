"""How simulated servos move, measure and protect themselves, in time of their own."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.dynamixel.bus import make_servos
from crtk_sim_backends.dynamixel.config import parse_servos
from crtk_sim_backends.dynamixel.legacy import OVERLOAD
from crtk_sim_backends.dynamixel.modern import ModernServo
from crtk_sim_backends.dynamixel.packets import Code, Error
from crtk_sim_backends.dynamixel.profile import (
    RECTANGLE,
    STEP,
    TRAPEZOID,
    TRIANGLE,
    Profile,
    by_time,
    by_velocity,
)
from crtk_sim_backends.dynamixel.servo import BOOT, Servo

UNIT = 2.0 * math.pi / 4096
VELOCITY_UNIT = 0.229 * 2.0 * math.pi / 60.0
ACCELERATION_UNIT = 214.577 * 2.0 * math.pi / 3600.0


class Rig:
    """One servo and its clock."""

    def __init__(self, text: str = "1:xm430-w350") -> None:
        servo = make_servos(parse_servos(text), 1_000_000, 0)[0]
        assert isinstance(servo, ModernServo)
        self.servo = servo
        self.now = 0.0

    def set(self, **values: int) -> Error:
        """Write registers by name; the last error."""
        error = Error.NONE
        for name, value in values.items():
            register = self.servo.table[name]
            error = self.servo.write(register.address, register.encode(value), self.now)
        return error

    def get(self, name: str) -> int:
        register = self.servo.table[name]
        error, data = self.servo.read(register.address, register.size, self.now)
        assert error is Error.NONE
        return register.decode(data)

    def after(self, seconds: float) -> Rig:
        self.now += seconds
        self.servo.refresh(self.now)
        return self

    def until(self, met: Callable[[], bool], limit: float = 20.0) -> float:
        """Seconds until a condition is met."""
        start = self.now
        while not met():
            assert self.now - start < limit
            self.after(0.002)
        return self.now - start


# Profiles


def sampled(profile: Profile) -> list[tuple[float, float, float]]:
    steps = 400
    return [profile.at(profile.duration * n / steps) for n in range(steps + 1)]


@given(
    start=st.floats(-10, 10),
    velocity=st.floats(-3, 3),
    goal=st.floats(-10, 10),
    limit=st.floats(0.05, 5),
    acceleration=st.floats(0.1, 50),
)
def test_profiles_are_continuous_end_at_rest_and_keep_their_limits(
    start: float, velocity: float, goal: float, limit: float, acceleration: float
) -> None:
    profile = by_velocity(start, velocity, goal, limit, acceleration)
    points = sampled(profile)
    assert points[0][0] == pytest.approx(start, abs=1e-9)
    assert profile.at(profile.duration)[:2] == (goal, 0.0)
    near_end = profile.at(profile.duration * (1.0 - 1e-9))
    assert near_end[0] == pytest.approx(goal, abs=1e-5)
    step = profile.duration / 400
    for (one, v1, a1), (two, v2, _) in itertools.pairwise(points):
        assert abs(a1) <= acceleration * (1 + 1e-9)
        assert abs(v2 - v1) <= acceleration * step * (1 + 1e-6) + 1e-9
        assert abs(two - one - 0.5 * (v1 + v2) * step) <= acceleration * step * step + 1e-9
        assert abs(v1) <= max(limit, abs(velocity)) + 1e-9


def test_kinds_of_profiles() -> None:
    assert by_velocity(0, 0, 1, 0, 5).kind == STEP
    assert by_velocity(0, 0, 1, 0.5, 0).kind == RECTANGLE
    assert by_velocity(0, 0, 1, 100.0, 5).kind == TRIANGLE
    assert by_velocity(0, 0, 1, 0.5, 5).kind == TRAPEZOID
    assert by_velocity(0, 0, 1, 0.5, 0).duration == pytest.approx(2.0)
    assert by_velocity(0, 0, 1, 0.5, 5).duration == pytest.approx(2.1)


@given(st.floats(-10, 10), st.floats(0.1, 20), st.floats(0, 20))
def test_time_based_profiles_take_their_time(goal: float, time: float, ramp: float) -> None:
    if abs(goal) > 1e-3:
        assert by_time(0.0, 0.0, goal, time, ramp).duration == pytest.approx(time, rel=1e-6)


# Position


def test_velocity_based_profile() -> None:
    rig = Rig()
    rig.set(torque_enable=1, profile_velocity=100, profile_acceleration=20)
    assert rig.get("moving") == 0
    rig.set(goal_position=3048)
    cruise, ramp = 100 * VELOCITY_UNIT, 20 * ACCELERATION_UNIT
    duration = 1000 * UNIT / cruise + cruise / ramp
    rig.after(duration / 2)
    assert rig.get("present_velocity") == pytest.approx(100, abs=2)
    assert rig.get("velocity_trajectory") == 100
    assert rig.get("moving") == 1
    assert rig.get("moving_status") & 0x33 == 0x32
    rig.after(duration / 2 - 0.01)
    assert rig.get("moving_status") & 0x02
    rig.after(0.02)
    assert rig.get("position_trajectory") == 3048
    rig.after(0.2)
    assert rig.get("present_position") == pytest.approx(3048, abs=1)
    assert rig.get("moving_status") & 0x03 == 0x01
    assert rig.get("moving") == 0


def test_time_based_profile_with_a_servo_in_reverse() -> None:
    rig = Rig()
    rig.set(drive_mode=0x05, torque_enable=1, profile_velocity=1500, profile_acceleration=300)
    rig.set(goal_position=1500)
    rig.after(1.48)
    assert rig.get("moving_status") & 0x02
    rig.after(0.2)
    assert not rig.get("moving_status") & 0x02
    assert rig.get("present_position") == pytest.approx(1500, abs=1)
    assert rig.servo.joint.angle == pytest.approx(548 * UNIT, abs=2 * UNIT)


def test_without_a_profile_it_goes_as_fast_as_the_motor_can() -> None:
    rig = Rig()
    rig.set(torque_enable=1, goal_position=4000)
    speeds = []
    while rig.get("present_position") < 3990:
        speeds.append(rig.after(0.005).get("present_velocity"))
    rig.until(lambda: rig.get("present_position") == 4000)
    assert 150 < max(speeds) < 46 / 0.229
    assert rig.get("moving_status") & 0x30 == 0


def test_a_new_goal_on_the_way_is_reached_without_a_jump() -> None:
    rig = Rig()
    rig.set(torque_enable=1, profile_velocity=100, profile_acceleration=20, goal_position=3500)
    rig.after(0.5)
    before = rig.get("velocity_trajectory")
    rig.set(goal_position=1000)
    assert rig.after(0.001).get("velocity_trajectory") == pytest.approx(before, abs=2)
    rig.until(lambda: rig.get("present_position") == 1000)


def test_gravity_needs_current_to_hold_and_more_gravity_more() -> None:
    held = []
    for gravity in (0, 1, 2):
        rig = Rig(f"1:xm430-w350~{gravity}")
        rig.set(torque_enable=1, profile_velocity=60, goal_position=2048 + 1024 * (gravity > -1))
        rig.after(4.0)
        assert rig.get("present_position") == pytest.approx(3072, abs=2)
        held.append(-rig.get("present_current") * 0.00269 * 4.1 / 2.3)
    assert held == pytest.approx([0.0, 1.0, 2.0], abs=0.1)


def test_without_torque_it_falls() -> None:
    rig = Rig("1:xm430-w350~2")
    rig.servo.joint.angle = 0.5
    rig.servo.joint.wake()
    rig.after(3.0)
    assert rig.servo.joint.angle > 2.0
    assert rig.get("present_current") == 0


def test_a_stale_goal_is_pursued_when_torque_goes_on() -> None:
    rig = Rig()
    rig.servo.joint.angle = 0.5
    rig.servo.joint.wake()
    assert rig.after(0.1).get("goal_position") == 2048
    rig.set(torque_enable=1)
    rig.after(1.0)
    assert rig.get("present_position") == 2048


def test_torque_by_goal_update() -> None:
    rig = Rig("1:xm430-w350@46")
    rig.set(drive_mode=0x08, goal_velocity=10)
    assert rig.get("torque_enable") == 0
    rig.set(goal_position=2100)
    assert rig.get("torque_enable") == 1
    assert rig.after(1.0).get("present_position") == 2100


def test_full_turns() -> None:
    rig = Rig()
    rig.set(operating_mode=4, torque_enable=1, goal_position=-10_000)
    rig.until(lambda: rig.get("present_position") == -10_000)
    rig.set(torque_enable=0)
    rig.set(operating_mode=3)
    assert rig.get("present_position") == -10_000 % 4096


# Other modes


def test_velocity_mode_ramps() -> None:
    rig = Rig("1:xm430-w350~1")
    rig.set(operating_mode=1, torque_enable=1, profile_acceleration=5, goal_velocity=-100)
    time = 100 * VELOCITY_UNIT / (5 * ACCELERATION_UNIT)
    rig.after(time / 2)
    assert rig.get("velocity_trajectory") == pytest.approx(-50, abs=1)
    assert rig.get("present_velocity") == pytest.approx(-50, abs=4)
    rig.after(time)
    assert rig.get("present_velocity") == pytest.approx(-100, abs=3)
    before = rig.get("present_position")
    rig.after(1.0)
    assert rig.get("present_position") - before == pytest.approx(
        -100 * VELOCITY_UNIT / UNIT, rel=0.01
    )
    rig.set(goal_velocity=0)
    rig.after(2.0)
    assert rig.get("present_velocity") == 0


def test_current_mode_pushes_with_its_current() -> None:
    rig = Rig()
    rig.set(operating_mode=0, torque_enable=1, goal_current=-100)
    rig.after(0.02)
    assert rig.get("present_current") == -100
    assert rig.get("present_velocity") < 0
    rig.after(3.0)
    assert rig.get("present_current") > -100  # the motor's line takes over at speed
    rig.set(goal_current=0)
    assert rig.after(0.01).get("present_current") == 0


def test_current_based_position_yields() -> None:
    rig = Rig()
    rig.set(operating_mode=5, torque_enable=1, goal_current=50)
    rig.servo.joint.push = -0.5
    rig.servo.joint.wake()
    rig.after(0.3)
    assert rig.get("present_position") < 1900  # pushed away against 50 counts
    assert rig.get("present_current") == 50
    rig.servo.joint.push = 0.0
    rig.servo.joint.wake()
    rig.until(lambda: rig.get("present_position") == 2048)


def test_pwm_mode() -> None:
    rig = Rig()
    rig.set(operating_mode=16, torque_enable=1, goal_pwm=443)
    rig.after(2.0)
    assert rig.get("present_pwm") == pytest.approx(443, abs=1)
    assert rig.get("present_velocity") * 0.229 == pytest.approx(46 / 2, rel=0.1)
    assert Rig("1:xl430-w250").set(operating_mode=16) is Error.NONE


def test_models_without_current_report_a_load() -> None:
    rig = Rig("1:xl430-w250~0.7")
    rig.set(torque_enable=1, profile_velocity=50, goal_position=3072)
    rig.after(4.0)
    assert rig.get("present_load") == pytest.approx(-500, abs=40)


# Protection


def test_bus_watchdog_trips_locks_the_goals_and_is_cleared() -> None:
    rig = Rig()
    rig.set(operating_mode=1, bus_watchdog=5)
    rig.after(1.0)
    assert rig.get("bus_watchdog") == 5  # only with torque
    rig.set(torque_enable=1, goal_velocity=100)
    for _ in range(5):
        rig.servo.heard(rig.now)
        rig.after(0.09)
    assert rig.get("bus_watchdog") == 5
    assert rig.get("present_velocity") > 90
    rig.after(0.05)
    rig.after(0.5)
    assert rig.get("bus_watchdog") == -1
    assert rig.get("present_velocity") == 0
    assert rig.get("torque_enable") == 1
    assert rig.set(goal_velocity=100) is Error.RANGE
    rig.servo.heard(rig.now)
    assert rig.after(0.1).get("bus_watchdog") == -1
    assert rig.set(bus_watchdog=0) is Error.NONE
    assert rig.set(goal_velocity=100) is Error.NONE
    assert rig.after(1.0).get("present_velocity") > 90


def test_a_watchdog_stops_where_it_was_when_time_was_up() -> None:
    rig = Rig()
    rig.set(torque_enable=1, profile_velocity=50, bus_watchdog=5, goal_position=4000)
    rig.after(3.0)  # seen late: it had stopped long before
    expected = 2048 + 0.1 * 50 * VELOCITY_UNIT / UNIT
    assert rig.get("present_position") == pytest.approx(expected, abs=30)
    assert rig.get("profile_velocity") == 0


def test_a_blocked_servo_overloads_and_shuts_down() -> None:
    rig = Rig()
    rig.servo.joint.stuck = True
    rig.set(torque_enable=1, profile_velocity=50, goal_position=4000)
    rig.after(1.0)
    assert rig.get("present_position") == 2048
    assert rig.get("moving_status") & 0x08
    assert rig.get("present_current") > 700
    time = rig.until(lambda: rig.get("hardware_error_status") == 0x20)
    assert 1.0 < time < 4.0
    assert rig.get("torque_enable") == 0
    assert rig.get("present_current") == 0
    assert rig.servo.error_bits == 0x80


def test_heat() -> None:
    rig = Rig()
    rig.servo.heat_source = 85.0
    rig.after(0.1)
    assert rig.get("hardware_error_status") == 0x04
    rig.servo.heat_source = None
    rig.after(1000.0)
    assert rig.get("present_temperature") < 30


def test_working_hard_heats_up() -> None:
    rig = Rig("1:xm430-w350~3")
    rig.set(torque_enable=1, profile_velocity=50, goal_position=3072)
    rig.after(3.0)
    rig.after(200.0)
    assert rig.get("present_temperature") > 60


def test_startup_configuration_and_reboot() -> None:
    rig = Rig()
    rig.set(startup_configuration=3, profile_velocity=33)
    assert rig.servo.execute(Code.BACKUP, b"\x01CTRL", rig.now, broadcast=False)[0] is Error.NONE
    rig.servo.execute(Code.REBOOT, b"", rig.now, broadcast=False)
    assert not rig.servo.listens(rig.now + BOOT / 2)
    rig.after(BOOT)
    assert rig.servo.listens(rig.now)
    assert rig.get("torque_enable") == 1
    assert rig.get("profile_velocity") == 33


def test_tick_wraps() -> None:
    rig = Rig()
    rig.after(32.0)
    assert rig.get("realtime_tick") == pytest.approx(32000, abs=1)
    rig.after(1.0)
    assert rig.get("realtime_tick") == pytest.approx(33000 - 32768, abs=1)


def test_a_joint_of_two_servos_shares_the_work() -> None:
    servos = make_servos(parse_servos("2:xm540-w270~4,3:xm540-w270&2"), 1_000_000, 0)
    for servo in servos:
        assert servo.write(64, b"\x01", 0.1) is Error.NONE
        servo.write(112, (50).to_bytes(4, "little"), 0.1)
        servo.write(116, (3072).to_bytes(4, "little"), 0.1)
    currents = []
    for servo in servos:
        servo.refresh(5.0)
        assert servo["present_position"] == pytest.approx(3072, abs=1)
        currents.append(servo["present_current"])
    torque = -currents[0] * 0.00269 * 10.6 / 4.4
    assert torque == pytest.approx(2.0, abs=0.3)  # friction holds a part
    assert currents[0] == pytest.approx(currents[1], abs=1)  # counts agree: it runs in reverse


def test_looking_often_or_seldom_makes_no_difference() -> None:
    ends = []
    for period in (0.0005, 0.003, 0.05):
        rig = Rig("1:xm430-w350~1")
        rig.set(torque_enable=1, profile_velocity=80, profile_acceleration=10, goal_position=3000)
        while rig.now < 0.6:
            rig.after(period)
        ends.append(rig.get("present_position"))
    assert max(ends) - min(ends) < 60 * 80 * VELOCITY_UNIT / UNIT * 0.05


# Protocol 1.0


def legacy_servo(text: str) -> Servo:
    return make_servos(parse_servos(text), 1_000_000, 0)[0]


def put(servo: Servo, name: str, value: int, time: float) -> Error:
    register = servo.table[name]
    return servo.write(register.address, register.encode(value), time)


def test_an_ax_moves_when_a_goal_is_written() -> None:
    servo = legacy_servo("1:ax-12a")
    put(servo, "moving_speed", 200, 0.1)
    put(servo, "goal_position", 700, 0.1)
    assert servo["torque_enable"] == 1
    servo.refresh(0.3)
    assert servo["moving"] == 1
    assert servo["present_speed"] == pytest.approx(200, abs=10)
    servo.refresh(3.0)
    assert (servo["present_position"], servo["moving"]) == (700, 0)
    put(servo, "goal_position", 512, 3.0)
    servo.refresh(3.2)
    assert servo["present_speed"] == pytest.approx(0x400 + 200, abs=10)


def test_wheel_mode_and_multi_turn_of_an_mx() -> None:
    servo = legacy_servo("1:mx-64-1.0")
    put(servo, "cw_angle_limit", 0, 0.1)
    put(servo, "ccw_angle_limit", 0, 0.1)
    put(servo, "moving_speed", 0x400 + 300, 0.1)
    servo.refresh(2.0)
    assert servo["present_speed"] == pytest.approx(0x400 + 300, abs=5)
    put(servo, "torque_enable", 0, 2.0)
    put(servo, "cw_angle_limit", 4095, 2.0)
    put(servo, "ccw_angle_limit", 4095, 2.0)
    put(servo, "moving_speed", 0, 2.0)
    put(servo, "goal_position", 9000, 2.0)
    servo.refresh(20.0)
    assert servo["present_position"] == pytest.approx(9000, abs=1)


def test_errors_of_protocol_1_are_bits_and_take_torque() -> None:
    servo = legacy_servo("1:ax-12a")
    put(servo, "torque_enable", 1, 0.1)
    servo.heat_source = 90.0
    servo.refresh(0.2)
    assert servo.error_bits == 0x04
    assert servo["torque_enable"] == 0
    put(servo, "goal_position", 600, 0.3)
    assert servo["torque_enable"] == 0


def test_an_mx_in_torque_mode_heeds_no_goal() -> None:
    servo = legacy_servo("1:mx-64-1.0")
    put(servo, "torque_control_mode_enable", 1, 0.1)
    put(servo, "goal_torque", 0x400 + 200, 0.1)
    assert servo["torque_enable"] == 0, "neither turns torque on"
    put(servo, "torque_enable", 1, 0.1)
    put(servo, "goal_position", 3000, 0.2)
    servo.refresh(0.6)
    assert servo["present_speed"] > 0x400 + 100
    put(servo, "torque_control_mode_enable", 0, 0.6)
    servo.refresh(3.0)
    assert servo["present_position"] == pytest.approx(3000, abs=1)


def test_a_shutdown_takes_the_torque_limit() -> None:
    servo = legacy_servo("1:ax-12a")
    put(servo, "torque_enable", 1, 0.1)
    servo.force_error(OVERLOAD)
    assert (servo["torque_enable"], servo["torque_limit"]) == (0, 0)
