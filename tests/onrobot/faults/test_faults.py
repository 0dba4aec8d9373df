"""What goes wrong with a gripper and the way to it: what is told, and that nothing opens by itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

from crtk_driver_onrobot import grip, registers
from crtk_drivers.errors import CommandRefused, DeviceError, MotionAborted
from crtk_drivers.state import OperatingState
from crtk_sim_backends.onrobot import SIM, RunningSim
from rigs.onrobot_bench import FREE_PORTS, LINKS, OnRobotBench, bench, configuration
from rigs.waiting import LONG, eventually

ENABLED, DISABLED = OperatingState.ENABLED, OperatingState.DISABLED
PAUSED, FAULT = OperatingState.PAUSED, OperatingState.FAULT
WIDTH = 0.03
"""Of what is gripped, in m."""
WIDER = WIDTH + 0.002
"""To which no finger may open that holds it."""


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """A simulated RG2, open, as nobody has used it."""
    shared.control.clear()
    shared.control.inject("object_lost")
    shared.control.inject("unpowered")
    shared.control.clear()
    shared.control.inject("other_master", opening=0.09)
    eventually(lambda: shared.control.call("status")["opening"] > 0.0899, "open")
    yield shared
    shared.control.clear()


@pytest.fixture(params=LINKS)
def running(sim: RunningSim, request: pytest.FixtureRequest) -> Iterator[OnRobotBench]:
    """A driver at it, on each way."""
    with OnRobotBench(sim, configuration(sim, link=request.param)) as bench:
        yield bench


@pytest.fixture
def box(sim: RunningSim) -> Iterator[OnRobotBench]:
    """A driver at the Compute Box."""
    with OnRobotBench(sim, configuration(sim)) as bench:
        yield bench


@pytest.fixture
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a driver look sooner at what seldom changes: who is there, and with which fingers."""
    monkeypatch.setattr(registers, "LOOK", 0.1)


def gripped(bench: OnRobotBench) -> None:
    """Let it hold something."""
    bench.sim.control.inject("object", width=WIDTH)
    bench.front.enable()
    assert bench.front.move_jp([0.0]).wait(LONG)
    bench.grip("holds an object")
    assert bench.front.state.holds()


def holds_on(bench: OnRobotBench) -> None:
    """The fingers are where they were."""
    assert bench.simulated("opening") < WIDER


# ------------------------------------------------------------------------------------------ the grip


def test_a_stream_is_followed_to_its_end(box: OnRobotBench) -> None:
    box.front.enable()
    here = box.front.setpoint_js().position[0]
    for step in range(1, 40):
        sent = box.front.health().setpoints
        box.front.servo_jp([here - 0.0005 * step])
        eventually(lambda sent=sent: box.front.health().setpoints > sent, "executed")
    goal = here - 0.0005 * 39
    eventually(lambda: abs(box.simulated("opening") - goal) < 0.0005, "followed")


def test_a_stream_that_asks_for_what_is_held_is_told_all_the_while_that_it_is(
    box: OnRobotBench,
) -> None:
    gripped(box)
    box.front.servo_jp([WIDTH])
    for step in range(1, 21):
        box.front.servo_jp([WIDTH - 0.0002 * step])
        box.samples(1)
    box.samples(1)
    eventually(lambda: box.device.has_arrived, "all of it is taken")
    box.grip("holds an object")
    writes = box.simulated("writes")
    for _ in range(20):
        box.front.servo_jp([WIDTH - 0.004])
        box.samples(1)
        assert box.front.state.holds()
    assert box.simulated("writes") == writes, "asked once"


def test_an_object_that_slips_slowly_is_held_and_measured(box: OnRobotBench) -> None:
    gripped(box)
    box.sim.control.inject("slip", speed=0.02)
    eventually(lambda: box.front.measured_js().position[0] < WIDTH - 0.005, "thinner")
    box.sim.control.clear("slip")
    box.state(ENABLED)
    assert box.front.state.holds()


def test_a_force_is_in_newtons(box: OnRobotBench) -> None:
    box.front.enable()
    box.front.force(25.0)
    box.front.move_jp([0.05]).wait(LONG)
    assert box.simulated("written").startswith("250 ")
    for wrong in (41.0, 0.3, -1.0, 250.0, math.nan, math.inf):
        with pytest.raises(CommandRefused, match="force"):
            box.front.force(wrong)


# ----------------------------------------------------------------------------- commands it ignores


def test_a_command_that_is_ignored_is_told(box: OnRobotBench) -> None:
    box.front.enable()
    box.sim.control.inject("deaf")
    with pytest.raises(MotionAborted, match="takes no command"):
        box.front.move_jp([0.05]).wait(LONG)
    box.sim.control.clear()
    assert box.front.move_jp([0.05]).wait(LONG)
    assert box.counter("ignored") == 3


def test_a_command_that_is_ignored_once_is_sent_again(
    box: OnRobotBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grip, "TRIES", 1000)  # more than there are until a test has noticed
    box.front.enable()
    box.sim.control.inject("deaf")
    move = box.front.move_jp([0.05])
    eventually(lambda: box.counter("ignored") > 0, "noticed")
    box.sim.control.clear()
    assert move.wait(LONG)


def test_a_gripper_that_stays_busy_is_told(box: OnRobotBench) -> None:
    box.front.enable()
    box.sim.control.inject("stuck_busy")
    box.state(PAUSED, "another program")
    # Who judges first, the watch over the stop or resume itself, is up to the I/O thread.
    with pytest.raises(DeviceError, match=r"not been carried out|not come to rest"):
        box.front.resume()
    box.sim.control.clear()
    eventually(lambda: not box.simulated("busy"), "free")
    box.front.enable()
    assert box.front.move_jp([0.05]).wait(LONG)


# ----------------------------------------------------------------------------- what would move it


def test_a_command_that_was_not_sent_when_the_link_was_lost_is_not_sent_later(
    sim: RunningSim,
) -> None:
    with OnRobotBench(sim, configuration(sim, sample_timeout=1.0)) as box:
        gripped(box)
        sim.control.inject("unit_silent")
        box.front.move_jp([0.08])
        box.state(FAULT)
        sim.control.inject("disconnect")
        sim.control.clear()
        sim.control.inject("object", width=WIDTH)
        box.connected()
        before = box.simulated("writes")
        box.front.enable()
        box.samples(20)
        assert box.simulated("writes") == before


def test_power_that_goes_and_comes_leaves_the_grip_as_it_is(sim: RunningSim) -> None:
    config = configuration(sim, open_timeout=0.5, sample_timeout=1.2)
    with OnRobotBench(sim, config) as box:
        gripped(box)
        box.sim.control.inject("unpowered")
        box.state(FAULT, "nothing answers behind the gateway")
        box.sim.control.clear("unpowered")
        box.connected()
        box.state(DISABLED)
        holds_on(box)


# --------------------------------------------------------------------------------- who is there


def test_another_model_is_refused(sim: RunningSim) -> None:
    before = sim.control.call("status")["writes"]
    session = OnRobotBench(sim, configuration(sim, model="rg6"))
    session.session.start()
    try:
        detail = session.state(FAULT, "this is RG2 SIM0001, and RG6 is configured")
        assert "Set model" in detail
        assert session.simulated("writes") == before
    finally:
        session.front.close()


@pytest.mark.usefixtures("looks_often")
@pytest.mark.parametrize(
    ("kind", "parameters", "text"),
    [
        ("replaced", {"serial": "OTHER"}, "replaced by RG2 OTHER"),
        ("other_model", {"model": "rg6"}, "this is RG6"),
    ],
)
def test_a_tool_that_is_replaced_is_noticed(
    box: OnRobotBench, kind: str, parameters: dict[str, str], text: str
) -> None:
    box.front.enable()
    before = box.simulated("writes")
    box.sim.control.inject(kind, **parameters)
    eventually(lambda: box.session.engine.status.state is not ENABLED, "noticed")
    if kind == "replaced":
        box.connected()
        assert "OTHER" in box.front.state.tool()
        box.state(DISABLED)
    else:
        box.state(FAULT, text)
    assert box.simulated("writes") == before


def test_the_range_is_that_of_the_fingers_that_are_mounted() -> None:
    fingers = {"lower": 0.035, "upper": 0.073, "closed": 0.5}
    with bench("2fg7", simulated=fingers) as running:
        running.front.enable()
        assert running.front.state.range() == pytest.approx((0.035, 0.073))
        before = running.simulated("writes")
        with pytest.raises((CommandRefused, MotionAborted), match=r"0\.0350 to 0\.0730"):
            running.front.move_jp([0.01]).wait(LONG)
        assert running.simulated("writes") == before
        assert running.front.move_jp([0.04]).wait(LONG)


def test_fingertips_have_a_thickness() -> None:
    with bench("rg2", simulated={"offset": 0.005}) as running:
        assert running.front.state.range() == pytest.approx((0.0, 0.1))
        running.front.enable()
        assert running.front.move_jp([0.02]).wait(LONG)
        assert running.front.measured_js().position[0] == pytest.approx(0.02, abs=0.0005)


@pytest.mark.usefixtures("looks_often")
def test_fingertips_that_leave_no_way_to_go_are_told_and_the_range_is_never_negative() -> None:
    with bench("rg2") as running:
        running.front.enable()
        before = running.simulated("writes")
        running.sim.control.inject("fingertips", offset=0.06)
        running.state(FAULT, "60.0 mm thick each")
        assert running.simulated("writes") == before
        running.sim.control.clear("fingertips")
        running.connected()
        running.state(DISABLED)
        running.front.enable()
        assert running.front.move_jp([0.02]).wait(LONG)


def test_it_grips_from_inside() -> None:
    around = {"width": 0.05, "around": True}
    with bench("2fg7", grip="inside", force=60.0) as running:
        running.front.enable()
        running.front.move_jp([0.02]).wait(LONG)
        running.sim.control.inject("object", **around)
        assert running.front.move_jp([0.07]).wait(LONG)
        running.grip("holds an object")
        assert running.front.measured_js().effort[0] == pytest.approx(60.0)
        assert running.simulated("written").endswith(" 2")


def test_release_on_close_lets_go_of_what_is_held_from_inside() -> None:
    with SIM.spawn(**FREE_PORTS, model="2fg7") as sim:
        config = configuration(sim, model="2fg7", grip="inside", on_close="release")
        with OnRobotBench(sim, config) as held:
            held.front.enable()
            held.front.move_jp([0.02]).wait(LONG)
            sim.control.inject("object", width=0.05, around=True)
            assert held.front.move_jp([0.07]).wait(LONG)
            held.grip("holds an object")
        eventually(lambda: sim.control.call("status")["opening"] < 0.045, "let go")


# -------------------------------------------------------------------------------- faults it reports


@pytest.mark.parametrize("number", [1, 2])
def test_a_safety_switch_latches_until_power_has_been_away(box: OnRobotBench, number: int) -> None:
    gripped(box)
    box.sim.control.inject("safety_switch", number=number)
    box.state(FAULT, f"safety switch {number} is pushed")
    box.sim.control.clear("safety_switch")
    detail = eventually(
        lambda: "tripped" in box.front.state.fault() and box.front.state.fault(), "latched"
    )
    assert "power_cycle" in detail
    with pytest.raises(DeviceError, match="tripped"):
        box.front.enable()
    assert box.front.power_cycle()
    eventually(lambda: box.front.state.fault() == "", "cleared")
    box.connected()
    box.front.enable()
    holds_on(box)


def test_a_switch_that_is_pushed_at_power_on_is_told(box: OnRobotBench) -> None:
    box.sim.control.inject("flags", set=0x40)
    box.state(FAULT, "when it was powered on")


FLAGS = {
    0x04: "switch 1 is pushed",
    0x08: "circuit 1",
    0x10: "switch 2 is pushed",
    0x20: "circuit 2",
}


@pytest.mark.sweep(3)
@pytest.mark.parametrize(("bit", "text"), FLAGS.items())
def test_each_bit_of_the_status(box: OnRobotBench, bit: int, text: str) -> None:
    box.sim.control.inject("flags", set=bit)
    box.state(FAULT, text)
    box.sim.control.clear()
    eventually(lambda: box.front.state.fault() == "", "gone")


def test_a_3fg_that_is_not_calibrated() -> None:
    with bench("3fg15") as running:
        running.sim.control.inject("flags", clear=0x08)
        running.state(FAULT, "not calibrated")


def test_another_master_pauses_and_resume_takes_over(box: OnRobotBench) -> None:
    box.front.enable()
    box.front.move_jp([0.05]).wait(LONG)
    box.sim.control.inject("other_master", opening=0.09)
    box.state(PAUSED, "another program")
    box.front.resume()
    box.state(ENABLED)
    assert box.front.move_jp([0.05]).wait(LONG)


# ------------------------------------------------------------------------------------------ the line


@pytest.mark.sweep(4)
@pytest.mark.parametrize(
    ("link", "kind", "parameters"),
    [
        ("serial", "bad_crc", {"every": 3}),
        ("serial", "cut", {"every": 3}),
        ("serial", "doubled", {"every": 1}),
        ("serial", "noise", {}),
        ("serial", "late", {"seconds": 0.02}),
        ("modbus", "doubled", {"every": 1}),
        ("modbus", "late", {"seconds": 0.02}),
        ("modbus", "exception", {"code": 4, "every": 3}),
        ("modbus", "exception", {"code": 11, "every": 3}),
    ],
    ids=lambda x: str(x),
)
def test_a_bad_line_is_lived_with(
    sim: RunningSim, link: str, kind: str, parameters: dict[str, Any]
) -> None:
    """Openings stay true, moves end, and nothing is told that was not."""
    with OnRobotBench(sim, configuration(sim, link=link)) as bench:
        bench.front.enable()
        bench.sim.control.inject(kind, **parameters)
        assert bench.front.move_jp([0.06]).wait(LONG)
        assert bench.front.measured_js().position[0] == pytest.approx(0.06, abs=0.001)
        bench.state(ENABLED)


@pytest.mark.sweep(3)
@pytest.mark.parametrize("code", [1, 2, 3])
def test_an_exception_that_does_not_pass_is_told(box: OnRobotBench, code: int) -> None:
    box.front.enable()
    box.sim.control.inject("exception", code=code)
    box.state(FAULT, f"exception {code}")
    box.sim.control.clear("exception")
    box.connected()
    box.state(DISABLED)


@pytest.mark.sweep(3)
@pytest.mark.parametrize("code", [4, 5, 6])
def test_an_exception_that_stays_is_told(sim: RunningSim, code: int) -> None:
    config = configuration(sim, open_timeout=0.5, sample_timeout=0.3)
    with OnRobotBench(sim, config) as bench:
        sim.control.inject("exception", code=code)
        eventually(lambda: "exception" in bench.session.engine.status.detail, "told")


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"address": 70}, "nothing answers behind the gateway"),
        ({"link": "serial", "address": 70}, "does not answer"),
        ({"link": "serial", "baud": 115_200}, "does not answer"),
    ],
)
def test_a_wrong_address_or_rate_is_told(
    sim: RunningSim, values: dict[str, Any], text: str
) -> None:
    bench = OnRobotBench(sim, configuration(sim, open_timeout=0.3, **values))
    bench.session.start()
    try:
        bench.state(FAULT, text)
    finally:
        bench.front.close()


# ----------------------------------------------------------------------------------- bad commands
