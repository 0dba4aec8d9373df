"""Streams of setpoints, cycle by cycle, on a clock of its own."""

import math

import numpy as np
import pytest

from crtk_drivers.device import Condition, Mode
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import (
    CommandRefused,
    Reason,
)
from crtk_drivers.samples import Twist, vector
from crtk_drivers.state import OperatingState
from rigs.scripted_engine import PERIOD, Rig, jf, jp, jv, pose, two_joints

S = OperatingState
THREE = vector((0.0, 0.0, 0.0))


def test_nothing_is_written_on_enable_and_the_setpoint_is_where_the_device_is() -> None:
    rig = Rig().connect()
    rig.device.position = np.array([0.3, -0.3])
    rig.cycle()
    rig.enabled()
    rig.cycle(5)
    assert rig.written == []
    assert rig.setpoint() == {"position": [0.3, -0.3], "velocity": [], "effort": []}


def test_a_disabled_device_is_seeded_anew_after_it_was_moved() -> None:
    rig = Rig().enabled()
    rig.servo(0.05, 0.05)
    rig.cycle()
    rig.command("disable")
    rig.device.position = np.array([0.8, 0.8])
    rig.cycle()
    rig.enabled()
    assert rig.setpoint()["position"] == [0.8, 0.8]
    assert rig.refused("servo_jp", jp(0.05, 0.05)).reason is Reason.STEP_TOO_LARGE


@pytest.mark.parametrize(
    ("policy", "state"), [("hold", S.ENABLED), ("pause", S.PAUSED), ("fault", S.FAULT)]
)
@pytest.mark.parametrize("name", ["servo_jp", "servo_jv"])
def test_a_stream_that_stops(policy: str, state: OperatingState, name: str) -> None:
    rig = Rig(EngineOptions(stream_timeout=0.1, on_stream_timeout=policy)).enabled()
    value = {"servo_jp": jp(0.01, 0.0), "servo_jv": jv(0.1, 0.0)}[name]
    rig.engine.submit(name, value)
    rig.cycle(9)
    assert rig.engine.health().stream == name
    rig.cycle(4)
    assert rig.state is state
    assert rig.engine.health().stream == ""
    assert rig.engine.health().stream_timeouts == 1
    velocity = name == "servo_jv"
    assert ("stop" in rig.device.calls) is (velocity or policy != "hold")
    assert rig.setpoint()["velocity"] == []
    if policy != "hold":
        assert name in rig.engine.status.detail
    rig.cycle(20)
    assert len(rig.written) == 1


def test_a_refused_stream_does_not_count_as_alive() -> None:
    rig = Rig(EngineOptions(stream_timeout=0.1, on_stream_timeout="pause")).enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    for _ in range(12):
        with pytest.raises(CommandRefused):
            rig.engine.submit("servo_jv", jv(math.nan, 0.0))
        rig.cycle()
    assert rig.state is S.PAUSED


def test_increments_are_added_up_between_two_cycles() -> None:
    rig = Rig().enabled()
    for _ in range(5):
        rig.engine.submit("servo_jr", jp(0.002, -0.004))
    rig.cycle()
    assert rig.written[-1].values.tolist() == pytest.approx([0.01, -0.02])
    rig.engine.submit("servo_jr", jp(0.002, 0.0))
    rig.cycle()
    assert rig.written[-1].values.tolist() == pytest.approx([0.012, -0.02])


def test_increments_that_add_up_to_a_jump_are_refused_in_the_io_thread() -> None:
    rig = Rig().enabled()
    for _ in range(5):
        rig.engine.submit("servo_jr", jp(0.05, 0.0))
    rig.cycle()
    assert rig.written == []
    assert [refusal.reason for refusal in rig.told.refusals] == [Reason.STEP_TOO_LARGE]


def test_a_stream_that_outruns_the_velocity_limit_is_refused_and_a_slower_one_is_not() -> None:
    rig = Rig().enabled()
    for index in range(1, 60):  # 1.0 rad/s, the limit, for 0.6 s
        rig.servo(index * PERIOD * 1.0, 0.0)
        rig.cycle()
    assert rig.told.refusals == []
    assert len(rig.written) == 59
    rig = Rig().enabled()
    for index in range(1, 40):
        try:
            rig.servo(index * PERIOD * 2.0, 0.0)
        except CommandRefused:
            break
        rig.cycle()
    assert rig.told.refusals[0].reason is Reason.STEP_TOO_LARGE
    assert "faster" in rig.told.refusals[0].message
    assert rig.written[-1].values[0] < 0.3


def test_two_kinds_of_stream_do_not_alternate() -> None:
    rig = Rig(EngineOptions(mode_switch_dwell=0.1)).enabled()
    for _ in range(5):
        rig.servo(0.0, 0.0)
        rig.cycle()
        assert rig.refused("servo_jf", jf(0.1, 0.1)).reason is Reason.MODE_SWITCH
    assert rig.engine.health().refusals == {"servo_jf: mode_switch": 5}
    rig.cycle(15)
    rig.engine.submit("servo_jf", jf(0.1, 0.1))
    rig.cycle()
    assert rig.written[-1].mode is Mode.JOINT_EFFORT
    assert rig.refused("servo_jp", jp(0.0, 0.0)).reason is Reason.MODE_SWITCH
    rig.engine.submit("hold")
    rig.servo(0.0, 0.0)  # hold ends a stream at once


SETPOINTS = {
    "servo_jp": (jp(0.01, 0.02), [0.01, 0.02], [], []),
    "servo_cp": (pose(0.01, 0.02), [0.01, 0.02], [], []),
    "servo_jr": (jp(0.01, 0.02), [0.01, 0.02], [], []),
    "servo_jv": (jv(0.01, 0.02), [], [0.01, 0.02], []),
    "servo_jf": (jf(0.01, 0.02), [], [], [0.01, 0.02]),
    "servo_cv": (Twist(vector((0.1, 0, 0)), THREE), [], [], []),
}


@pytest.mark.parametrize("name", SETPOINTS)
def test_the_setpoint_holds_what_the_level_says(name: str) -> None:
    value, position, velocity, effort = SETPOINTS[name]
    rig = Rig().enabled()
    rig.engine.submit(name, value)
    rig.cycle()
    state, stamp = rig.value("setpoint_js")
    assert state.name == ("slide", "turn")
    assert stamp == rig.value("measured_js")[1]
    assert rig.setpoint() == {
        "position": pytest.approx(position),
        "velocity": velocity,
        "effort": effort,
    }
    _, cartesian_stamp = rig.value("setpoint_cp")
    assert (cartesian_stamp != 0) is bool(position), "valid under position commands only"


def test_the_setpoint_of_a_move_holds_position_and_velocity_of_the_trajectory() -> None:
    rig = Rig().enabled()
    rig.engine.submit("move_jp", jp(0.5, 0.0))
    rig.cycle(30)
    setpoint = rig.setpoint()
    assert 0.0 < setpoint["position"][0] < 0.5
    assert setpoint["velocity"][0] > 0.1
    assert setpoint["position"] == rig.written[-1].values.tolist()
    assert rig.value("setpoint_cp")[1] != 0


@pytest.mark.parametrize("state", [S.DISABLED, S.FAULT])
def test_the_setpoint_is_not_valid_unless_enabled_or_paused(state: OperatingState) -> None:
    rig = Rig().enabled()
    assert rig.value("setpoint_js")[1] != 0
    rig.device.reported = Condition(state)
    rig.cycle()
    assert rig.value("setpoint_js")[1] == 0
    assert rig.value("setpoint_cp")[1] == 0
    assert rig.value("measured_js")[1] != 0


def test_a_device_that_wants_its_setpoint_every_cycle_gets_it_only_while_enabled() -> None:
    rig = Rig(capabilities=two_joints(writes_every_cycle=True)).enabled()
    rig.cycle(3)
    assert rig.written == [], "nothing is sent before a command"
    rig.servo(0.01, 0.0)
    rig.cycle(5)
    assert [setpoint.values[0] for setpoint in rig.written] == [0.01] * 5
    rig.command("pause")
    rig.cycle(5)
    assert len(rig.written) == 5
