"""What goes wrong with a gripper and the way to it: what is told, and that nothing opens by itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from crtk_drivers.errors import CommandRefused, DataTimeout, DeviceError, MotionAborted
from crtk_drivers.state import OperatingState
from crtk_sim_backends.robotiq import SIM, RunningSim
from rigs.robotiq_bench import FREE_PORTS, LINKS, RobotiqBench, bench, configuration
from rigs.waiting import LONG, eventually

ENABLED, DISABLED = OperatingState.ENABLED, OperatingState.DISABLED
PAUSED, FAULT = OperatingState.PAUSED, OperatingState.FAULT
WIDTH = 0.03
"""Of what is gripped, in m."""
WIDER = WIDTH + 0.004
"""To which no finger may open that holds it."""


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """A simulated gripper, activated, open, as nobody has used it."""
    shared.control.clear()
    if shared.control.call("status")["state"] != "active":
        shared.control.inject("deactivated")
        shared.control.inject("activated")
    shared.control.inject("other_master", position=0)
    eventually(
        lambda: (
            shared.control.call("status")["state"] == "active"
            and shared.control.call("status")["opening"] > 0.08
        ),
        "ready",
    )
    yield shared
    shared.control.clear()


@pytest.fixture(params=LINKS)
def running(sim: RunningSim, request: pytest.FixtureRequest) -> Iterator[RobotiqBench]:
    """A driver at it, on each way."""
    with RobotiqBench(sim, configuration(sim, link=request.param)) as bench:
        yield bench


@pytest.fixture
def line(sim: RunningSim) -> Iterator[RobotiqBench]:
    """A driver at its tool line."""
    with RobotiqBench(sim, configuration(sim, link="tool")) as bench:
        yield bench


def gripped(bench: RobotiqBench) -> None:
    """Let it hold something."""
    bench.sim.control.inject("object", width=WIDTH)
    bench.front.enable()
    assert bench.front.move_jp([0.0]).wait(LONG)
    bench.grip("closed on an object")
    assert bench.front.state.holds()


def holds_on(bench: RobotiqBench) -> None:
    """The fingers are where they were, and have been nowhere else."""
    assert bench.simulated("opening") < WIDER


# ------------------------------------------------------------------------------------------ the grip


@pytest.mark.sweep(4)
def test_a_move_ends_at_what_it_grips(running: RobotiqBench) -> None:
    gripped(running)
    assert running.front.measured_js().position[0] == pytest.approx(WIDTH, abs=0.003)
    assert running.front.goal_js().position[0] == 0.0
    running.front.move_jp([0.06]).wait(LONG)
    running.grip("at the position")
    assert not running.front.state.holds()


@pytest.mark.sweep(4)
@pytest.mark.parametrize("link", LINKS)
def test_an_object_detection_that_lags_is_waited_for(link: str) -> None:
    """A gripper whose gOBJ is still that of the last command when the echo is that of this one."""
    with bench(link, simulated={"object_lag": 0.1, "object_width": WIDTH}) as slow:
        slow.front.enable()
        for _ in range(3):
            slow.front.move_jp([0.06]).wait(LONG)
            assert not slow.front.state.holds()
            slow.front.move_jp([0.0]).wait(LONG)
            assert slow.front.state.holds()
            assert slow.front.measured_js().position[0] == pytest.approx(WIDTH, abs=0.003)


@pytest.mark.sweep(4)
def test_an_object_that_slips_out_is_told(running: RobotiqBench) -> None:
    gripped(running)
    running.sim.control.inject("object_lost")
    running.grip("object lost")
    assert not running.front.state.holds()
    notes = {note.key: note.text for note in running.front.health().notes}
    assert notes == {"object": "what it held is gone"}
    running.state(ENABLED)


def test_something_may_be_held_from_inside(line: RobotiqBench) -> None:
    line.front.enable()
    line.front.move_jp([0.01]).wait(LONG)
    line.sim.control.inject("object", width=0.05, around=True)
    line.front.move_jp([0.085]).wait(LONG)
    line.grip("opened onto an object")
    assert line.front.measured_js().position[0] == pytest.approx(0.05, abs=0.003)


@pytest.mark.sweep(4)
@pytest.mark.parametrize("command", ["disable", "pause", "hold"])
def test_what_stops_it_keeps_the_grip(running: RobotiqBench, command: str) -> None:
    gripped(running)
    getattr(running.front, command)()
    running.samples(20)
    holds_on(running)
    assert running.simulated("written").startswith("09"), "it goes on gripping"


def test_a_motion_is_stopped_where_it_is(line: RobotiqBench) -> None:
    line.front.enable()
    line.front.trajectory_j.set_ratio(0.01)
    move = line.front.move_jp([0.0])
    eventually(lambda: line.simulated("moves"), "it moves")
    line.front.hold()
    with pytest.raises(MotionAborted):
        move.wait(LONG)
    eventually(lambda: line.simulated("written").startswith("01"), "stopped")
    assert line.simulated("opening") > 0.01


def test_a_force_is_a_share(line: RobotiqBench) -> None:
    line.front.enable()
    line.front.force(1.0)
    line.front.move_jp([0.05]).wait(LONG)
    assert line.simulated("written").endswith("ff")
    for wrong in (1.5, -0.1, math.nan, 40.0):
        with pytest.raises(CommandRefused, match="force"):
            line.front.force(wrong)


def test_effort_is_what_the_motor_presses_with_and_gone_when_it_rests(sim: RunningSim) -> None:
    config = configuration(sim, link="tool", newtons_per_ampere=250.0)
    with RobotiqBench(sim, config) as bench:
        bench.sim.control.inject("object", width=WIDTH)
        bench.front.enable()
        efforts: list[float] = []
        move = bench.front.move_jp([0.0])
        while not move.wait(0.005):
            efforts.append(bench.front.measured_js().effort[0])
        bench.grip("closed on an object")
        assert min(efforts) < -20.0, "closing presses to the negative side"
        eventually(lambda: bench.front.measured_js().effort[0] == 0.0, "no current at rest")


# ----------------------------------------------------------------------------- what would move it


@pytest.mark.sweep(4)
def test_connecting_writes_nothing_and_finds_what_is_held(running: RobotiqBench) -> None:
    gripped(running)
    running.front.close()
    before = running.simulated("writes")
    sim, link = running.sim, running.device._config.link
    with RobotiqBench(sim, configuration(sim, link=link)) as again:
        detail = again.state(DISABLED)
        assert "closed on an object" in detail
        again.samples(20)
        assert again.simulated("writes") == before
        again.front.enable()
        again.samples(20)
        assert again.simulated("writes") == before, "activated: there is nothing to do"
        holds_on(again)


@pytest.mark.sweep(4)
def test_a_lost_link_opens_nothing(running: RobotiqBench) -> None:
    gripped(running)
    before = running.simulated("writes")
    running.sim.control.inject("disconnect")
    running.state(FAULT)
    running.sim.control.clear("disconnect")
    running.connected()
    running.state(DISABLED)
    running.front.enable()
    running.samples(20)
    assert running.simulated("writes") == before
    holds_on(running)
    assert running.front.state.holds()


def test_release_on_close_opens_nothing_where_the_driver_gives_up_a_link_that_works(
    sim: RunningSim,
) -> None:
    """It closes the link and opens it again: that is no end of the program."""
    with RobotiqBench(sim, configuration(sim, link="tool", on_close="release")) as bench:
        gripped(bench)
        reconnects = bench.front.health().reconnects
        sim.control.inject("exception", code=2, every=20)
        eventually(lambda: bench.front.health().reconnects > reconnects, "given up")
        sim.control.clear("exception")
        bench.connected()
        bench.samples(20)
        holds_on(bench)


def test_release_on_close_opens_once_and_only_in_good_order(sim: RunningSim) -> None:
    config = configuration(sim, link="tool", on_close="release")
    with RobotiqBench(sim, config) as bench:
        gripped(bench)
        sim.control.inject("disconnect")
        bench.state(FAULT)
        sim.control.clear("disconnect")
        bench.connected()
        before = bench.simulated("writes")
    assert bench.simulated("writes") == before, "it was not enabled since"
    with RobotiqBench(sim, config) as bench:
        bench.front.enable()
    eventually(lambda: sim.control.call("status")["opening"] > 0.08, "opened at the end")


@pytest.mark.parametrize("on_close", ["hold", "nothing"])
def test_closing_keeps_a_grip(sim: RunningSim, on_close: str) -> None:
    with RobotiqBench(sim, configuration(sim, link="tool", on_close=on_close)) as bench:
        gripped(bench)
        before = bench.simulated("writes")
    assert bench.simulated("writes") == before
    holds_on(bench)


def test_nothing_on_close_lets_a_motion_go_on_and_says_so(sim: RunningSim) -> None:
    with RobotiqBench(sim, configuration(sim, link="tool", on_close="nothing")) as bench:
        bench.front.enable()
        bench.front.trajectory_j.set_ratio(0.01)
        bench.front.move_jp([0.0])
        eventually(lambda: bench.simulated("moves"), "it moves")
        with pytest.raises(DeviceError, match="stop has not been carried out"):
            bench.front.close()
    eventually(lambda: sim.control.call("status")["opening"] < 0.002, "it goes on to its goal")


def test_a_gripper_that_lost_its_power_while_it_held_is_not_opened_by_enable(
    line: RobotiqBench,
) -> None:
    """As by the emergency stop of the arm, which takes the tool's supply."""
    gripped(line)
    line.sim.control.inject("unpowered")
    line.state(FAULT)
    line.sim.control.clear("unpowered")
    line.connected()
    line.state(DISABLED)
    with pytest.raises(DeviceError, match="may still hold something"):
        line.front.enable()
    holds_on(line)
    assert line.front.activate() == "activated"
    line.front.enable()
    assert line.simulated("widest") > 0.08


@pytest.mark.sweep(3)
@pytest.mark.parametrize("policy", ["if needed", "always", "never"])
def test_activation_is_asked_for(policy: str) -> None:
    with bench(simulated={"activated": False}, activate=policy) as running:
        running.state(DISABLED)
        assert running.simulated("writes") == 0
        if policy == "never":
            with pytest.raises(DeviceError, match="not activated"):
                running.front.enable()
            assert running.simulated("writes") == 0
            return
        running.front.enable()
        assert running.simulated("state") == "active"
        writes = running.simulated("writes")
        running.front.disable()
        running.front.enable()
        assert (running.simulated("writes") > writes) is (policy == "always")


# --------------------------------------------------------------------------- somebody else at it


@pytest.mark.sweep(4)
def test_a_reset_by_the_pendant_is_disabled(running: RobotiqBench) -> None:
    running.front.enable()
    running.front.move_jp([0.05]).wait(LONG)
    running.sim.control.inject("deactivated")
    running.state(DISABLED, "not activated")
    running.sim.control.inject("activated")
    running.samples(20)
    running.state(DISABLED)
    running.front.enable()
    running.state(ENABLED)


def test_a_reset_ends_a_move(line: RobotiqBench) -> None:
    line.front.enable()
    line.front.trajectory_j.set_ratio(0.01)
    move = line.front.move_jp([0.0])
    eventually(lambda: line.simulated("moves"), "it moves")
    line.sim.control.inject("deactivated")
    with pytest.raises(MotionAborted):
        move.wait(LONG)
    line.state(DISABLED, "not activated")


@pytest.mark.sweep(4)
def test_another_master_pauses_and_resume_takes_over(running: RobotiqBench) -> None:
    running.front.enable()
    running.front.move_jp([0.05]).wait(LONG)
    running.sim.control.inject("other_master", position=200)
    running.state(PAUSED, "another program")
    running.front.resume()
    running.samples(20)
    running.state(ENABLED)
    running.front.move_jp([0.05]).wait(LONG)


@pytest.mark.sweep(4)
def test_enable_ends_a_motion_that_somebody_else_has_begun(running: RobotiqBench) -> None:
    running.grip("at the position")
    running.sim.control.inject("other_master", position=255, speed=0)
    running.grip("moving")
    running.front.enable()
    assert running.simulated("written").startswith("01")
    here = running.simulated("opening")
    running.samples(10)
    assert running.simulated("opening") == here > 0.01


def test_another_model_is_not_activated(line: RobotiqBench) -> None:
    line.front.enable()
    line.sim.control.inject("other_model", model="2f-140")
    line.state(DISABLED, "not activated")


def test_another_program_on_the_tool_line_takes_answers_away_and_none_is_wrong(
    line: RobotiqBench,
) -> None:
    """As with socat, whose clients share one line: some answers are lost, and no value is made up."""
    line.front.enable()
    line.front.move_jp([0.05]).wait(LONG)
    here = line.front.measured_js().position[0]
    with RobotiqBench(line.sim, configuration(line.sim, link="tool")) as other:
        for _ in range(50):
            line.samples(1)
            assert line.front.measured_js().position[0] == here
        assert other.front.measured_js().position[0] == here
    assert line.counter("missed") > 0


# -------------------------------------------------------------------------------- faults it reports

MAJOR = {
    0xA: "supply",
    0xB: "automatic release",
    0xC: "internal",
    0xD: "activation failed",
    0xE: "overcurrent",
    0xF: "automatic release",
}


@pytest.mark.sweep(6)
@pytest.mark.parametrize(("code", "text"), MAJOR.items(), ids=lambda x: f"{x}")
def test_a_major_fault_stops_it_and_enable_activates_anew(
    line: RobotiqBench, code: int, text: str
) -> None:
    line.front.enable()
    line.sim.control.inject("gripper_fault", code=code)
    detail = line.state(FAULT, text)
    assert "activated anew" in detail
    assert text in line.front.state.fault()
    line.sim.control.clear("gripper_fault")
    line.front.enable()
    line.state(ENABLED)
    assert line.front.state.fault() == ""


def test_a_hot_gripper_is_a_fault_until_it_is_cool(line: RobotiqBench) -> None:
    line.front.enable()
    line.sim.control.inject("gripper_fault", code=8)
    line.state(FAULT, "too hot")
    with pytest.raises(DeviceError, match="cool down"):
        line.front.enable()
    line.sim.control.clear("gripper_fault")
    eventually(lambda: line.front.state.fault() == "", "cool")
    line.front.enable()


@pytest.mark.parametrize("code", [4, 5, 9, 0xC, 0xE])
def test_a_fault_of_the_controller(line: RobotiqBench, code: int) -> None:
    line.front.enable()
    line.sim.control.inject("controller_fault", code=code)
    line.state(FAULT, "controller")
    line.sim.control.clear("controller_fault")
    eventually(lambda: line.front.state.fault() == "", "gone")
    line.front.enable()


def test_that_it_heard_nothing_hinders_nothing(line: RobotiqBench) -> None:
    line.front.enable()
    line.sim.control.inject("gripper_fault", code=9)
    line.front.move_jp([0.05]).wait(LONG)
    line.state(ENABLED)


# ------------------------------------------------------------------------------------------ the line


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("bad_crc", {"every": 3}),
        ("cut", {"every": 3}),
        ("doubled", {"every": 1}),
        ("noise", {}),
        ("late", {"seconds": 0.02}),
        ("exception", {"code": 5, "every": 3}),
        ("exception", {"code": 6, "every": 3}),
        ("exception", {"code": 4, "every": 3}),
    ],
    ids=lambda x: str(x),
)
@pytest.mark.parametrize("link", ["serial", "tool"])
@pytest.mark.sweep(3)
def test_a_bad_line_is_lived_with(
    sim: RunningSim, link: str, kind: str, parameters: dict[str, Any]
) -> None:
    """Positions stay true, moves end, and nothing is told that was not."""
    with RobotiqBench(sim, configuration(sim, link=link)) as bench:
        bench.front.enable()
        bench.sim.control.inject(kind, **parameters)
        for goal in (0.03, 0.06):
            assert bench.front.move_jp([goal]).wait(LONG)
            assert bench.front.measured_js().position[0] == pytest.approx(goal, abs=0.001)
        bench.state(ENABLED)


@pytest.mark.sweep(4)
@pytest.mark.parametrize("link", LINKS)
def test_a_unit_that_falls_silent_is_a_fault_and_found_again(sim: RunningSim, link: str) -> None:
    config = configuration(sim, link=link, open_timeout=1.0, sample_timeout=0.5)
    with RobotiqBench(sim, config) as bench:
        bench.front.enable()
        sim.control.inject("unit_silent")
        eventually(lambda: "not answer" in bench.session.engine.status.detail, "told")
        sim.control.clear("unit_silent")
        bench.connected()
        bench.state(DISABLED)


@pytest.mark.parametrize("code", [1, 2, 3])
def test_an_exception_that_does_not_pass_is_told(line: RobotiqBench, code: int) -> None:
    line.front.enable()
    line.sim.control.inject("exception", code=code)
    line.state(FAULT, f"exception {code}")
    line.sim.control.clear("exception")
    line.connected()
    line.state(DISABLED)


@pytest.mark.parametrize("code", [4, 5, 6])
def test_an_exception_that_stays_is_told(sim: RunningSim, code: int) -> None:
    config = configuration(sim, link="tool", open_timeout=0.5, sample_timeout=0.3)
    with RobotiqBench(sim, config) as bench:
        sim.control.inject("exception", code=code)
        eventually(lambda: "exception" in bench.session.engine.status.detail, "told")


def test_answers_that_are_later_than_the_timeout_are_never_taken_for_new_ones(
    sim: RunningSim,
) -> None:
    config = configuration(sim, link="tool", reply_timeout=0.02, sample_timeout=0.5)
    with RobotiqBench(sim, config) as bench:
        before = bench.front.health().samples
        sim.control.inject("late", seconds=0.03)
        bench.state(FAULT)
        assert bench.front.health().samples - before < 10
        assert bench.counter("strange_bytes") > 0


def test_a_second_program_at_another_rate_is_told_as_bytes_that_are_no_answer(
    sim: RunningSim,
) -> None:
    sim.control.inject("bad_crc")
    config = configuration(sim, link="tool", open_timeout=0.5)
    bench = RobotiqBench(sim, config)
    bench.session.start()
    try:
        detail = bench.state(FAULT, "none of them are an answer")
        assert "baud rate" in detail
    finally:
        bench.front.close()


@pytest.mark.parametrize("newline", [True, False])
def test_the_text_server_with_and_without_ends_of_lines(newline: bool) -> None:
    with bench("urcap", simulated={"urcap_newline": newline}) as running:
        running.front.enable()
        running.front.move_jp([0.03]).wait(LONG)
        assert running.front.measured_js().position[0] == pytest.approx(0.03, abs=0.001)
        assert running.front.measured_js().effort.size == 0
        with pytest.raises(DataTimeout, match="state/current"):
            running.front.state.current()


# ----------------------------------------------------------------------------------- bad commands


@pytest.mark.parametrize(
    "send",
    [
        lambda front: front.move_jp([math.nan]),
        lambda front: front.move_jp([0.086]),
        lambda front: front.move_jp([-0.001]),
        lambda front: front.move_jp([0.01, 0.02]),
        lambda front: front.servo_jp([math.inf]),
        lambda front: front.servo_jp([]),
    ],
)
def test_what_is_no_opening_is_refused(line: RobotiqBench, send: Callable[[Any], object]) -> None:
    line.front.enable()
    before = line.simulated("writes")
    with pytest.raises(CommandRefused):
        send(line.front)
    line.samples(10)
    assert line.simulated("writes") == before


@pytest.mark.parametrize("model", ["2f-140", "hand-e"])
def test_other_models_in_their_units(model: str) -> None:
    with bench(simulated={"model": model}, model=model) as running:
        top = running.device.capabilities.limits[0].upper
        running.front.enable()
        running.front.move_jp([0.5 * top]).wait(LONG)
        assert running.simulated("opening") == pytest.approx(0.5 * top, abs=0.001)


def test_a_jaw_in_radians() -> None:
    with bench(unit="rad") as running:
        running.front.enable()
        running.front.move_jp([0.4]).wait(LONG)
        assert running.simulated("opening") == pytest.approx(0.0425, abs=0.001)
        assert running.front.measured_js().position[0] == pytest.approx(0.4, abs=0.004)
