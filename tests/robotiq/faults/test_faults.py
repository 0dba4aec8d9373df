"""What goes wrong with a gripper and the way to it: what is told, and that nothing opens by itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

from crtk_drivers.errors import CommandRefused, DataTimeout, DeviceError, MotionAborted
from crtk_drivers.motion.past import Moment
from crtk_drivers.samples import JointState
from crtk_drivers.state import OperatingState
from crtk_sim_backends.robotiq import SIM, RunningSim
from rigs.robotiq_bench import (
    AJAR,
    FREE_PORTS,
    LINKS,
    RobotiqBench,
    activate_anew,
    bench,
    configuration,
)
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
        activate_anew(shared)
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
    bench.grip("holds an object")
    assert bench.front.state.holds()


def holds_on(bench: RobotiqBench) -> None:
    """The fingers are where they were, and have been nowhere else."""
    assert bench.simulated("opening") < WIDER


# ------------------------------------------------------------------------------------------ the grip


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


@pytest.mark.sweep(2)
@pytest.mark.parametrize("link", LINKS)
def test_end_of_the_move_before_is_no_arrival(link: str) -> None:
    """The next one is sent as the fingers arrive, before gOBJ tells that."""
    with bench(link, simulated={"object_lag": 0.1}) as slow:
        slow.front.enable()
        for goal in (0.06, 0.03, 0.06, 0.03):
            slow.front.move_jp([goal])
            eventually(lambda to=goal: abs(slow.simulated("opening") - to) < 0.001, "there")
            assert slow.front.move_jp([0.0]).wait(LONG)
            assert slow.simulated("opening") < 0.002


def test_something_may_be_held_from_inside(line: RobotiqBench) -> None:
    line.front.enable()
    line.front.move_jp([0.01]).wait(LONG)
    line.sim.control.inject("object", width=0.05, around=True)
    line.front.move_jp([0.085]).wait(LONG)
    line.grip("holds an object from inside")
    assert line.front.measured_js().position[0] == pytest.approx(0.05, abs=0.003)


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

        def keep(moment: Moment) -> None:
            state = moment[1].values["measured_js"]
            assert isinstance(state, JointState)
            efforts.append(float(state.effort[0]))

        bench.session.engine.keepers = (keep,)
        assert bench.front.move_jp([0.0]).wait(LONG)
        bench.grip("holds an object")
        assert min(efforts) < -20.0, "closing presses to the negative side"
        eventually(lambda: bench.front.measured_js().effort[0] == 0.0, "no current at rest")


def test_fingers_that_close_further_as_something_is_lost_are_stopped(line: RobotiqBench) -> None:
    line.front.enable()
    assert line.front.move_jp([0.06]).wait(LONG)
    line.front.trajectory_j.set_ratio(0.01)
    line.sim.control.inject("object", width=0.055)
    assert line.front.move_jp([0.0]).wait(LONG)
    line.grip("holds an object")
    line.sim.control.inject("object_lost")
    line.grip("object lost")
    line.front.hold()
    line.samples(2)
    eventually(lambda: line.device.has_stopped, "read back")
    assert line.simulated("opening") > 0.005
    assert not line.simulated("moves")


def test_a_stop_leads_nowhere_back(sim: RunningSim) -> None:
    """What has just been met, and is not told yet, would be let go."""
    positions: list[float] = []

    def keep(moment: Moment) -> None:
        state = moment[1].values["measured_js"]
        assert isinstance(state, JointState)
        positions.append(float(state.position[0]))

    with RobotiqBench(sim, configuration(sim, link="tool", rate=6.0)) as bench:
        bench.front.enable()
        assert bench.front.move_jp([0.085]).wait(LONG)
        bench.session.engine.keepers = (keep,)
        bench.front.trajectory_j.set_ratio(0.3)
        bench.front.move_jp([0.0])
        eventually(lambda: min(positions, default=1.0) < 0.08, "it closes")
        bench.front.hold()
        bench.samples(2)
        eventually(lambda: bench.device.has_stopped, "read back")
        bench.samples(2)
    assert 0.01 < positions[-1] <= min(positions)


@pytest.mark.parametrize("force", [0.0, 1.0])
def test_a_stop_while_it_grips_anew_keeps_what_it_holds(line: RobotiqBench, force: float) -> None:
    """With another force: until it has told what it meets, it counts as moving."""
    gripped(line)
    writes = line.simulated("writes")
    line.front.force(force)
    line.front.move_jp([0.0])
    eventually(lambda: line.simulated("writes") > writes, "sent")
    line.front.hold()
    line.samples(2)
    eventually(lambda: line.device.has_stopped, "read back")
    line.grip("holds an object")
    holds_on(line)


# ----------------------------------------------------------------------------- what would move it


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


def test_nothing_on_close_lets_a_motion_go_on_and_says_so() -> None:
    """One that takes seconds longer than a stop of the model that it is taken for may."""
    with SIM.spawn(**FREE_PORTS, model="2f-140") as sim:
        config = configuration(sim, link="tool", model="hand-e", on_close="nothing")
        with RobotiqBench(sim, config) as bench:
            bench.front.enable()
            bench.front.trajectory_j.set_ratio(0.01)
            bench.front.move_jp([0.0])
            eventually(lambda: bench.simulated("moves"), "it moves")
            with pytest.raises(DeviceError, match="stop has not been carried out"):
                bench.front.close()
        eventually(lambda: sim.control.call("status")["opening"] < 0.002, "it goes on to its goal")


def test_a_gripper_that_lost_its_power_while_it_held_is_not_opened_by_enable(
    sim: RunningSim,
) -> None:
    """As by the emergency stop of the arm, which takes the tool's supply."""
    with RobotiqBench(sim, configuration(sim, link="tool", sample_timeout=1.0)) as line:
        gripped(line)
        sim.control.inject("reset_widest")
        sim.control.inject("unpowered")
        line.state(FAULT)
        sim.control.clear("unpowered")
        line.connected()
        line.state(DISABLED)
        with pytest.raises(DeviceError, match="may still hold something"):
            line.front.enable()
        holds_on(line)
        assert line.front.activate() == "activated"
        line.front.enable()
        assert line.simulated("widest") > 0.08


def test_power_that_was_away_for_a_moment_is_no_activation(line: RobotiqBench) -> None:
    """Too short to lose the link. A motion waits to be sent: one that was reset, it would activate."""
    gripped(line)
    line.sim.control.inject("unpowered")
    missed = line.counter("missed")
    line.front.move_jp([0.01])
    eventually(lambda: line.counter("missed") > missed + 6, "it is silent")
    line.sim.control.clear("unpowered")
    line.state(DISABLED, "not activated")
    line.samples(5)
    assert line.simulated("state") == "reset"
    holds_on(line)
    with pytest.raises(DataTimeout, match="not known now"):
        line.front.state.holds()  # it may hold it still


def test_a_stream_that_asks_for_what_is_held_is_told_all_the_while_that_it_is(
    line: RobotiqBench,
) -> None:
    gripped(line)
    for step in range(1, 21):
        line.front.servo_jp([WIDTH - 0.05 * step * WIDTH])
        line.samples(1)
    line.samples(1)
    eventually(lambda: line.device.has_stopped, "all of it is taken")
    line.grip("holds an object")
    writes = line.simulated("writes")
    for _ in range(20):
        line.front.servo_jp([0.0])
        line.samples(1)
        assert line.front.state.holds()
    assert line.simulated("writes") == writes, "asked once"


def test_the_first_motion_goes_out_though_answers_take_longer_than_a_cycle_has() -> None:
    """It writes rACT, which follows a status: both do not fit into one cycle."""
    with bench("tool", simulated={"activated": False, "object_width": AJAR}) as running:
        running.front.enable()
        running.sim.control.inject("object_lost")
        running.sim.control.inject("late", seconds=0.012)
        assert running.front.move_jp([0.03]).wait(LONG)


@pytest.mark.sweep(3)
@pytest.mark.parametrize("policy", ["if needed", "always", "never"])
def test_activation_is_asked_for(policy: str) -> None:
    soon = {"activated": False, "object_width": AJAR}
    with bench(simulated=soon, activate=policy) as running:
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
        writes = running.simulated("writes")
        running.front.pause()
        running.front.resume()
        assert running.simulated("writes") == writes


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


@pytest.mark.sweep(4)
@pytest.mark.parametrize("how", ["move", "stop"])
def test_a_reset_just_before_our_next_command_is_no_activation(
    running: RobotiqBench, how: str
) -> None:
    """Function 23 writes before it reads: what would activate must not be in a motion, or a stop."""
    gripped(running)
    if how == "stop":
        running.front.trajectory_j.set_ratio(0.01)
        running.front.move_jp([0.06])
        eventually(lambda: running.simulated("moves"), "it moves")
    running.sim.control.inject("deactivated_meanwhile")
    if how == "stop":
        running.front.hold()
    else:
        running.front.move_jp([0.06])
    running.state(DISABLED, "not activated")
    running.samples(10)
    assert running.simulated("state") == "reset"
    assert running.simulated("opening") < 0.05


@pytest.mark.sweep(3)
@pytest.mark.parametrize("samples", range(3))
def test_the_watchdogs_stop_by_the_text_server_activates_nothing(
    sim: RunningSim, samples: int
) -> None:
    """It is sent at once, and again by the I/O thread, which may not know yet that somebody has reset it."""
    with RobotiqBench(sim, configuration(sim, link="urcap")) as bench:
        bench.front.enable()
        bench.front.trajectory_j.set_ratio(0.01)
        bench.front.move_jp([0.0])
        eventually(lambda: bench.simulated("moves"), "it moves")
        bench.samples(samples)
        sim.control.inject("deactivated_meanwhile")
        bench.session.engine.alarm("the I/O thread is late")
        bench.samples(10)
        assert bench.simulated("state") == "reset"


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


@pytest.mark.parametrize("newer", [[], [0.03]], ids=["hold", "move-hold"])
def test_a_doubled_command_of_ours_is_stopped(line: RobotiqBench, newer: list[float]) -> None:
    """It comes once more, by a gateway, after the stop that has ended it."""
    line.front.enable()
    assert line.front.move_jp([0.08]).wait(LONG)
    line.front.trajectory_j.set_ratio(0.01)
    line.front.move_jp([0.02])
    eventually(lambda: line.simulated("moves"), "it moves")
    line.samples(3)
    sent = line.device._hand._grip.echo.command
    for goal in newer:
        line.front.move_jp([goal])
        line.samples(3)
    line.front.hold()
    eventually(lambda: not line.simulated("moves"), "it stands")
    line.samples(3)
    line.sim.control.inject("other_master", position=sent.position, speed=0)
    line.state(PAUSED, "another program")
    eventually(lambda: not line.simulated("moves"), "it is stopped")
    assert line.simulated("opening") > 0.04


@pytest.mark.sweep(4)
def test_enable_ends_a_motion_that_somebody_else_has_begun(running: RobotiqBench) -> None:
    running.grip("at the position")
    running.sim.control.inject("other_master", position=255, speed=0)
    running.grip("moving")
    running.front.enable()
    assert not running.simulated("moves")
    here = running.simulated("opening")
    running.samples(10)
    assert running.simulated("opening") == here > 0.01


def test_another_model_is_not_activated(line: RobotiqBench) -> None:
    line.front.enable()
    line.sim.control.inject("other_model", model="2f-140")
    line.state(DISABLED, "not activated")


def test_another_program_on_the_tool_line_takes_answers_away_and_none_is_wrong(
    sim: RunningSim,
) -> None:
    """As with socat, whose clients share one line: some answers are lost, and no value is made up."""
    config = configuration(sim, link="tool", reply_timeout=0.02)  # what is lost is soon asked again
    with RobotiqBench(sim, config) as line:
        line.front.enable()
        line.front.move_jp([0.05]).wait(LONG)
        here = line.front.measured_js().position[0]
        with RobotiqBench(sim, config) as other:
            for _ in range(20):
                line.samples(1)
                assert line.front.measured_js().position[0] == here
            assert other.front.measured_js().position[0] == here
            eventually(lambda: line.counter("missed") > 0, "an answer is lost")


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
    line.sim.control.inject("object", width=AJAR)
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
    config = configuration(sim, link=link, open_timeout=0.5, sample_timeout=0.5)
    with RobotiqBench(sim, config) as bench:
        bench.front.enable()
        sim.control.inject("unit_silent")
        eventually(lambda: "not answer" in bench.session.engine.status.detail, "told")
        sim.control.clear("unit_silent")
        bench.connected()
        bench.state(DISABLED)


@pytest.mark.parametrize("link", ["tool", "urcap"])
@pytest.mark.parametrize("by", ["hold", "loss"])
def test_a_stop_waits_for_no_lost_answer(sim: RunningSim, link: str, by: str) -> None:
    patience = 2.0 if by == "hold" else 0.5
    with RobotiqBench(sim, configuration(sim, link=link, sample_timeout=patience)) as bench:
        bench.front.enable()
        assert bench.front.move_jp([0.085]).wait(LONG)
        bench.front.trajectory_j.set_ratio_v(0.01)
        bench.front.move_jp([0.0])
        eventually(lambda: bench.simulated("opening") < 0.08, "it closes")
        sim.control.inject("unit_silent")
        if by == "hold":
            bench.front.hold()
        eventually(lambda: not bench.simulated("moves"), "it stands")
        assert bench.simulated("opening") > 0.05
        bench.state(FAULT)
        sim.control.clear("unit_silent")
        bench.samples(20)  # in which the stop is read back


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
        sim.control.inject("late", seconds=0.09)
        eventually(lambda: sim.control.status()["faults"], "answers are late")
        before = bench.front.health().samples
        bench.state(FAULT)
        assert bench.front.health().samples - before < 10
        eventually(lambda: bench.counter("strange_bytes") > 0, "they are left out")


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
