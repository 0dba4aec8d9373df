"""Inputs of the UR driver: slider, payload and outputs, as a simulated controller takes them."""

import socket
import struct
import threading
import time

import numpy as np
import pytest

from crtk_drivers.errors import Reason
from rigs.ur_bench import HOME, LONG, UrBench, eventually, ur_bench

VOLTAGE_BITS = {0: 4, 1: 8}
"""Bits of `analog_io_types` that make an analog output one of voltage."""


@pytest.fixture(scope="module")
def shared():
    with ur_bench({"stream_timeout": 10.0}) as bench:
        yield bench


@pytest.fixture
def bench(shared: UrBench) -> UrBench:
    shared.reset()
    return shared


def problems(bench: UrBench) -> dict[str, str]:
    return {note.key: note.text for note in bench.engine.health().notes if note.severity > 0}


def refused(bench: UrBench, name: str, value, reason: Reason) -> None:
    with bench.refused(reason, name):
        getattr(bench.arm, name)(value)


@pytest.mark.parametrize(
    ("name", "bit"),
    [
        ("digital_out_0", 0),
        ("digital_out_7", 7),
        ("configurable_out_0", 8),
        ("configurable_out_7", 15),
        ("tool_out_0", 16),
        ("tool_out_1", 17),
    ],
)
def test_a_digital_output_is_set_and_reset_and_the_others_are_left_alone(bench, name, bit):
    before = bench.outputs("actual_digital_output_bits")
    getattr(bench.arm, name)(True)
    bench.until_outputs(actual_digital_output_bits=(before | 1 << bit,))
    getattr(bench.arm, name)(False)
    bench.until_outputs(actual_digital_output_bits=(before & ~(1 << bit),))


def test_outputs_that_are_set_at_once_all_arrive(bench):
    for pin in range(8):
        getattr(bench.arm, f"digital_out_{pin}")(pin % 2 == 0)
        getattr(bench.arm, f"configurable_out_{pin}")(pin % 2 == 1)
    bench.until_outputs(actual_digital_output_bits=(0xAA55,))
    for pin in range(8):
        getattr(bench.arm, f"digital_out_{pin}")(False)
        getattr(bench.arm, f"configurable_out_{pin}")(False)
    bench.until_outputs(actual_digital_output_bits=(0,))
    assert problems(bench) == {}


def test_of_a_flood_the_newest_counts(bench):
    for i in range(2001):
        bench.arm.digital_out_1(i % 2 == 0)
    bench.until_outputs(actual_digital_output_bits=(2,))
    bench.arm.digital_out_1(False)
    bench.until_outputs(actual_digital_output_bits=(0,))


@pytest.mark.parametrize("channel", [0, 1])
def test_an_analog_output_is_volts_or_amperes(bench, channel):
    name, bit = f"standard_analog_output{channel}", VOLTAGE_BITS[channel]
    getattr(bench.arm, f"analog_out_{channel}_voltage")(2.5)
    eventually(lambda: bench.outputs(name) == pytest.approx(2.5), "2.5 V")
    assert bench.outputs("analog_io_types") & bit
    getattr(bench.arm, f"analog_out_{channel}_current")(0.012)
    eventually(lambda: bench.outputs(name) == pytest.approx(0.012), "12 mA")
    assert not bench.outputs("analog_io_types") & bit


def test_the_tool_gets_its_voltage_beside_a_move(bench):
    move = bench.arm.move_jp([0.5, *HOME[1:]])
    for voltage in (24.0, 12.0, 0.0):
        bench.arm.tool_voltage(voltage)
        bench.until_outputs(tool_output_voltage=(voltage,))
    assert move.wait(LONG)
    assert bench.status.state == "ENABLED"


def test_the_speed_slider_slows_a_move_down(bench):
    bench.arm.speed_slider(0.25)
    bench.until_outputs(target_speed_fraction=(0.25,))
    move = bench.arm.move_jp([0.6, *HOME[1:]])
    bench.until_moving(speed=0.1)
    assert bench.watch(0.5) < 0.6
    bench.arm.speed_slider(1.0)
    assert move.wait(LONG)
    bench.until_outputs(target_speed_fraction=(1.0,))


def test_payload_is_refused_in_a_stream_and_taken_when_that_has_ended(bench):
    q = np.array(HOME)
    for step in range(100):
        q[0] = 0.1 * np.sin(0.01 * step)
        bench.arm.servo_jp(q)
        time.sleep(0.004)
    with bench.refused(Reason.INVALID_TRANSITION, "payload_mass"):
        bench.arm.payload_mass(2.25)
    bench.arm.hold()
    bench.until_still()
    eventually(lambda: bench.engine._motion.rests, "the stream has ended")
    bench.arm.payload_mass(2.25)
    bench.until_outputs(payload=(2.25,))
    assert bench.status.state == "ENABLED"
    assert bench.arm.move_jp([0.3, *HOME[1:]]).wait(LONG)
    np.testing.assert_allclose(bench.q()[0], 0.3, atol=1e-3)


def test_payload_that_is_given_before_is_sent_by_enable():
    config = {"payload": {"mass": 0.5, "center_of_gravity": [0.0, 0.01, 0.02]}}
    with ur_bench(config) as bench:
        bench.arm.payload_mass(3.0)
        notes = {note.key: note.text for note in bench.engine.health().notes}
        assert "3 kg" in notes["payload_mass"]
        assert bench.outputs("payload") == 0.0
        bench.arm.enable(timeout=LONG)
        eventually(lambda: bench.outputs("payload") == 3.0, "payload")
        assert bench.outputs("payload_cog") == pytest.approx([0.0, 0.01, 0.02])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("speed_slider", -0.01),
        ("speed_slider", 1.01),
        ("payload_mass", -1.0),
        ("payload_mass", 101.0),
        ("tool_voltage", 5.0),
        ("analog_out_0_voltage", 10.1),
        ("analog_out_1_current", 0.0039),
        ("analog_out_1_current", 12.0),
    ],
)
def test_values_that_cannot_be_are_refused_and_change_nothing(shared, name, value):
    bench = shared
    before = bench.sim.control.status()["input_packages"]
    refused(bench, name, value, Reason.OUT_OF_RANGE)
    for bad in (float("nan"), float("inf")):
        refused(bench, name, bad, Reason.NOT_FINITE)
    refused(bench, name, "much", Reason.WRONG_TYPE)
    assert not any(
        "mask" in key for entry in bench.sim.control.trace(after=before) for key in entry["values"]
    )


def test_a_flag_is_true_or_false(bench):
    refused(bench, "digital_out_0", 1, Reason.WRONG_TYPE)


def test_an_output_that_another_client_has_is_said_so():
    names = b"configurable_digital_output_mask,configurable_digital_output"
    with ur_bench() as bench, socket.create_connection((bench.sim.host, 30004), LONG) as other:
        other.sendall(struct.pack(">HBH", 5, ord("V"), 2))
        assert other.recv(4) == b"\x00\x04V\x01"
        other.sendall(struct.pack(">HB", 3 + len(names), ord("I")) + names)
        assert other.recv(64)[3] > 0
        bench.arm.configurable_out_2(True)
        text = eventually(lambda: problems(bench).get("configurable_out_2"), "a note")
        assert "IN_USE" in text
        assert "Close the other client" in text
        bench.arm.digital_out_2(True)
        bench.until_outputs(actual_digital_output_bits=(4,))
        connections = lambda: len(bench.sim.control.status()["connections"]["rtde"])  # noqa: E731
        before = connections()
        other.close()
        eventually(lambda: connections() < before, "its variables are free")
        bench.arm.configurable_out_2(True)
        bench.until_outputs(actual_digital_output_bits=(4 | 1 << 10,))
        eventually(lambda: not problems(bench), "the note goes away")


def test_a_value_that_the_controller_does_not_take_is_said_so():
    """In local control the port for programs does nothing."""
    with ur_bench() as bench:
        bench.inject("local_control")
        eventually(lambda: bench.device._link.remote is False, "local control is seen")
        bench.arm.tool_voltage(12.0)
        text = eventually(lambda: problems(bench).get("tool_voltage"), "a note")
        assert "set to 12, but the controller does not report it" in text


def test_a_value_is_not_judged_by_a_state_from_before_its_time_was_over(bench, monkeypatch):
    """The I/O thread was held up after it had read that state."""
    geometry, inputs, held_up = bench.device._geometry, bench.device._inputs, threading.Event()
    follow = geometry.follow_tool

    def follow_late(state) -> None:
        follow(state)
        if inputs._checking and not held_up.is_set():
            late = max(until for _, until in inputs._checking.values())
            eventually(lambda: time.monotonic() > late, "its time is over")
            held_up.set()

    bench.inject("delay", port="rtde", seconds=0.2, direction="out")
    monkeypatch.setattr(geometry, "follow_tool", follow_late)
    bench.arm.digital_out_0(True)
    assert held_up.wait(LONG)
    eventually(lambda: not inputs.is_changing("digital_out_0"), "it is taken")
    assert "digital_out_0" not in problems(bench)
    bench.sim.control.clear()
    bench.arm.digital_out_0(False)
    bench.until_outputs(actual_digital_output_bits=(0,))


def test_outputs_after_the_controller_was_away():
    with ur_bench() as bench:
        bench.arm.digital_out_0(True)
        bench.until_outputs(actual_digital_output_bits=(1,))
        bench.sim.control.inject("disconnect", port="rtde", duration=LONG)
        eventually(lambda: bench.device.robot_state is None, "the link is lost")
        refused(bench, "digital_out_1", True, Reason.NOT_CONNECTED)
        bench.sim.control.clear("disconnect")
        bench.until_connected()
        bench.arm.digital_out_1(True)
        bench.until_outputs(actual_digital_output_bits=(3,))


@pytest.mark.parametrize(("model", "version"), [("ur5", "3.15.8"), ("ur10e", "5.23.0")])
def test_other_generations(model, version):
    with ur_bench(model=model, version=version) as bench:
        bench.arm.digital_out_3(True)
        bench.arm.speed_slider(0.5)
        bench.arm.tool_voltage(24.0)
        bench.until_outputs(
            actual_digital_output_bits=(8,), target_speed_fraction=(0.5,), tool_output_voltage=(24,)
        )
        assert problems(bench) == {}
