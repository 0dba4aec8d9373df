"""What goes wrong with a gripper and the way to it: what is told, and that nothing opens by itself."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from crtk_driver_schunk.gripper.faults import ERRORS
from crtk_drivers.errors import CommandRefused, DeviceError, MotionAborted, TransitionFailed
from crtk_drivers.state import OperatingState
from crtk_sim_backends.schunk.gripper import SIM, RunningSim
from rigs.schunk_bench import BRISK, FREE_PORTS, LINKS, SchunkBench, bench, configuration
from rigs.waiting import LONG, eventually

ENABLED, DISABLED = OperatingState.ENABLED, OperatingState.DISABLED
PAUSED, FAULT = OperatingState.PAUSED, OperatingState.FAULT
WIDTH = 0.03
"""Of what is gripped, in m."""
WIDER = WIDTH + 0.003
"""To which no finger may open that holds it."""
SLOW = 0.02
"""Ratio of a speed at which a test has time."""


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS, **BRISK, acknowledged=False) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """A simulated gripper as it is powered on, half open."""
    shared.control.clear()
    shared.control.inject("unpowered")
    shared.control.clear()
    yield shared
    shared.control.clear()


@pytest.fixture(params=LINKS)
def running(sim: RunningSim, request: pytest.FixtureRequest) -> Iterator[SchunkBench]:
    """A driver at it, on each way, enabled and open."""
    with enabled(sim, request.param) as bench:
        yield bench


@pytest.fixture
def web(sim: RunningSim) -> Iterator[SchunkBench]:
    """A driver at its web server."""
    with enabled(sim, "http") as bench:
        yield bench


@contextmanager
def enabled(sim: RunningSim, link: str, **values: Any) -> Iterator[SchunkBench]:
    """Run a driver at it, enabled and open."""
    with SchunkBench(sim, configuration(sim, link=link, **values)) as bench:
        enable(bench)
        bench.front.move_jp([0.05]).wait(LONG)
        yield bench


def enable(bench: SchunkBench) -> None:
    """Enable it when it has told the error that it begins with: that is acknowledged."""
    bench.samples(2)
    bench.front.enable()


def gripped(bench: SchunkBench) -> None:
    """Let it hold something."""
    bench.sim.control.inject("object", width=WIDTH)
    assert bench.front.move_jp([0.0]).wait(LONG)
    bench.grip("holds an object")
    assert bench.front.state.holds()
    bench.sim.control.inject("reset_widest")


def holds_on(bench: SchunkBench) -> None:
    """The fingers are where they were, have been nowhere else, and press."""
    assert bench.simulated("widest") < WIDER
    assert bench.simulated("grips")


# ------------------------------------------------------------------------------------------ the grip


@pytest.mark.sweep(4)
def test_a_move_to_the_closed_end_grips_and_an_object_that_slips_out_is_told(
    running: SchunkBench,
) -> None:
    gripped(running)
    assert running.front.measured_js().position[0] == pytest.approx(WIDTH, abs=0.001)
    assert running.simulated("force") == pytest.approx(75.0, abs=1.0)
    running.sim.control.inject("object_lost")
    running.grip("object lost")
    assert not running.front.state.holds()
    notes = {note.key: note.text for note in running.front.health().notes}
    assert notes["object"] == "what it held is gone"
    running.state(ENABLED)
    assert running.front.move_jp([0.06]).wait(LONG)
    running.grip("at the position")


def test_fingers_that_close_further_as_something_is_lost_are_stopped(web: SchunkBench) -> None:
    web.front.enable()
    web.front.force(3.0)
    assert web.front.move_jp([0.06]).wait(LONG)
    web.sim.control.inject("object", width=0.058)
    assert web.front.move_jp([0.0]).wait(LONG)
    web.sim.control.inject("object_lost")
    web.grip("object lost")
    web.front.hold()
    web.samples(2)
    eventually(lambda: web.device.has_stopped, "read back")
    here = web.simulated("opening")
    web.samples(10)
    assert web.simulated("opening") == here > 0.005


def test_something_that_slips_is_held_all_the_while(web: SchunkBench) -> None:
    gripped(web)
    web.sim.control.inject("slip", speed=0.01)
    eventually(lambda: web.front.measured_js().position[0] < WIDTH - 0.003, "thinner")
    assert web.front.state.grip() == "holds an object"
    assert web.front.measured_js().velocity[0] < 0.0


def test_nothing_to_grip_and_something_of_another_size_are_told(web: SchunkBench) -> None:
    web.front.move_jp([0.0]).wait(LONG)
    web.grip("nothing gripped")
    web.front.move_jp([0.05]).wait(LONG)
    web.sim.control.inject("wrong_part")
    web.sim.control.inject("object", width=WIDTH)
    web.front.move_jp([0.0]).wait(LONG)
    web.grip("holds an object of another size")
    assert web.front.state.holds()


def test_a_force_grips_inwards_and_outwards_and_is_in_newtons(web: SchunkBench) -> None:
    for force, around, width in ((-60.0, False, 0.03), (90.0, True, 0.06)):
        web.sim.control.inject("object", width=width, around=around)
        eventually(
            lambda f=force: (web.front.servo_jf([f]), web.front.state.holds())[1],
            "held while it streams",
        )
        assert web.simulated("force") == pytest.approx(abs(force), abs=1.0)
        web.samples(70)
        assert web.front.state.holds(), "also when the stream has ended"
        web.sim.control.clear("object")
        web.front.move_jp([0.05]).wait(LONG)


def test_a_move_that_is_blocked_is_a_fault_with_what_to_do(web: SchunkBench) -> None:
    web.sim.control.inject("object", width=WIDTH)
    with pytest.raises(MotionAborted):
        web.front.move_jp([0.02]).wait(LONG)
    assert "servo_jf" in web.state(FAULT, "blocked (F4)")
    web.front.enable()
    web.state(ENABLED)
    assert web.front.state.fault() == ""


def test_force_is_in_newtons(web: SchunkBench) -> None:
    web.front.force(150.0)
    web.front.move_jp([0.0]).wait(LONG)
    assert web.simulated("written").endswith("64000000")
    for wrong in (150.1, 0.0, -10.0, math.nan, math.inf):
        with pytest.raises(CommandRefused, match="force"):
            web.front.force(wrong)


# ----------------------------------------------------------------------------- what would move it


def test_power_that_comes_back_moves_nothing(sim: RunningSim) -> None:
    """It starts with an error, which enable acknowledges."""
    with enabled(sim, "http", sample_timeout=1.0) as web:
        sim.control.inject("reset_widest")
        sim.control.inject("unpowered")
        web.state(FAULT)
        sim.control.clear("unpowered")
        web.connected()
        web.state(FAULT, "fieldbus")
        writes = web.simulated("writes")
        web.samples(10)
        assert web.simulated("writes") == writes
        web.front.enable()
        web.samples(10)
        assert web.simulated("widest") == pytest.approx(0.05, abs=1e-4)
        assert not web.simulated("moves")


def test_services_are_for_their_states(web: SchunkBench) -> None:
    assert web.front.brake_test() == "its brake holds"
    gripped(web)
    with pytest.raises(CommandRefused, match="holds something"):
        web.front.brake_test()
    assert web.front.release() == "at the position"
    assert web.simulated("opening") == pytest.approx(WIDTH + 0.005, abs=0.001)
    with pytest.raises(CommandRefused, match="Disable it"):
        web.front.soft_reset()
    web.front.disable()
    for service in (web.front.release, web.front.brake_test):
        with pytest.raises(CommandRefused, match="not enabled"):
            service()
    web.front.soft_reset()
    web.state(FAULT, "fieldbus")
    web.front.enable()
    assert "enable acknowledges" in web.front.fast_stop()
    web.state(FAULT, "fast stop (D9)")
    web.front.enable()


def test_a_fast_stop_takes_the_place_of_a_service_that_runs(web: SchunkBench) -> None:
    web.sim.control.inject("deaf")
    release = web.session.engine.request("release")
    fast_stop = web.session.engine.request("fast_stop")
    with pytest.raises(TransitionFailed, match="broken off: by fast_stop"):
        release.wait(LONG)
    web.sim.control.clear("deaf")
    assert "enable acknowledges" in fast_stop.wait(LONG)
    web.state(FAULT, "fast stop (D9)")


def test_a_gripper_without_a_brake_keeps_nothing_and_tests_none() -> None:
    with bench(simulated={"model": "egu-50", "object_width": 0.03}) as running:
        running.front.enable()
        with pytest.raises(CommandRefused, match="no brake"):
            running.front.brake_test()
        running.front.move_jp([0.0]).wait(LONG)
        assert running.simulated("written").startswith("01100000"), "GPE is for models with one"


# ----------------------------------------------------------------------------------- its state, others


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    "code", [0x6D, 0x7E, 0xDE, 0xF2, 0xF4, 0x33], ids=lambda code: f"{code:02X}"
)
def test_an_error_stops_it_and_is_told_in_words(web: SchunkBench, code: int) -> None:
    web.sim.control.inject("error", code=code)
    detail = web.state(FAULT, f"({code:02X})")
    assert ERRORS[code].text in detail if code in ERRORS else "no table" in detail
    assert f"({code:02X})" in web.front.state.fault()
    with pytest.raises(DeviceError, match=f"{code:02X}"):
        web.front.enable()
    web.sim.control.clear("error")
    web.front.enable()
    web.state(ENABLED)


def test_a_warning_is_a_note(web: SchunkBench) -> None:
    web.sim.control.inject("warning", code=0x93)
    eventually(
        lambda: any("too hot (93)" in note.text for note in web.front.health().notes), "told"
    )
    web.front.move_jp([0.06]).wait(LONG)
    web.state(ENABLED)


@pytest.mark.parametrize(("kind", "text"), [("manual", "by hand"), ("shutdown", "shutdown")])
def test_what_cannot_be_used_is_disabled(web: SchunkBench, kind: str, text: str) -> None:
    web.sim.control.inject(kind)
    web.state(DISABLED, text)


@pytest.mark.sweep(4)
def test_another_master_pauses_it_and_resume_takes_over(running: SchunkBench) -> None:
    running.sim.control.inject("other_master", position=0.07, speed=0.008)
    running.state(PAUSED, "another program")
    running.front.resume()
    running.state(ENABLED)
    assert running.simulated("opening") < 0.069, "what the other had begun is stopped"
    assert running.front.move_jp([0.05]).wait(LONG)
    assert running.counter("commands_of_others") == 1


def test_a_gripper_that_takes_no_commands_is_told(web: SchunkBench) -> None:
    web.sim.control.inject("deaf")
    with pytest.raises(MotionAborted):
        web.front.move_jp([0.07]).wait(LONG)
    web.state(FAULT, "takes no commands")
    assert not web.simulated("moves")
    web.sim.control.clear("deaf")
    eventually(lambda: web.counter("commands_repeated") >= 4, "tried")
    web.front.enable()
    assert web.front.move_jp([0.06]).wait(LONG)


# ------------------------------------------------------------------------------------------- the way


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("link", "kind", "parameters"),
    [
        ("serial", "bad_crc", {"every": 3}),
        ("serial", "cut", {"every": 4}),
        ("tool", "doubled", {}),
        ("serial", "noise", {}),
        ("serial", "late", {"seconds": 0.02}),
        ("tool", "exception", {"code": 6, "every": 3}),
        ("http", "closes", {}),
        ("http", "doubled", {}),
        # In a world, the next question may be sent before the echo has come.
        pytest.param("http", "echoes", {"seconds": 0.001}, marks=pytest.mark.real_time),
        ("http", "chunked", {}),
        ("http", "late", {"seconds": 0.02}),
        ("http", "split", {"size": 7, "port": "http"}),
        ("http", "coalesce", {"seconds": 0.02, "port": "http"}),
        ("modbus", "split", {"size": 1, "port": "modbus"}),
    ],
    ids=lambda value: str(value),
)
def test_a_bad_way_is_lived_with(
    sim: RunningSim, link: str, kind: str, parameters: dict[str, Any]
) -> None:
    """Positions stay true, moves end, and nothing is told that was not."""
    sim.control.inject(kind, **parameters)
    with SchunkBench(sim, configuration(sim, link=link)) as bench:
        enable(bench)
        for goal in (0.03, 0.06):
            assert bench.front.move_jp([goal]).wait(LONG)
            assert bench.front.measured_js().position[0] == pytest.approx(goal, abs=1e-4)
        bench.state(ENABLED)


def test_answers_that_are_later_than_the_timeout_are_never_taken_for_new_ones(
    sim: RunningSim,
) -> None:
    config = configuration(sim, link="serial", reply_timeout=0.02, sample_timeout=0.5)
    with SchunkBench(sim, config) as bench:
        sim.control.inject("late", seconds=0.09)
        before = bench.front.health().samples
        bench.state(FAULT)
        assert bench.front.health().samples - before < 10


@pytest.mark.sweep(4)
@pytest.mark.parametrize("link", LINKS)
def test_a_unit_that_falls_silent_is_a_fault_and_found_again(sim: RunningSim, link: str) -> None:
    config = configuration(sim, link=link, open_timeout=0.5, sample_timeout=0.5)
    with SchunkBench(sim, config) as bench:
        enable(bench)
        sim.control.inject("unit_silent")
        eventually(lambda: "not answer" in bench.session.engine.status.detail, "told")
        sim.control.clear("unit_silent")
        bench.connected()
        bench.state(DISABLED)


@pytest.mark.parametrize(
    ("kind", "parameters", "text"),
    [
        ("http_status", {"code": 500}, "HTTP 500"),
        ("nonsense", {}, "busy"),
        ("corrupt", {"every": 1, "port": "http", "direction": "out"}, "it sent"),
    ],
)
def test_a_web_server_that_is_none_is_told(
    web: SchunkBench, kind: str, parameters: dict[str, Any], text: str
) -> None:
    web.sim.control.inject(kind, **parameters)
    web.state(FAULT, text)
    web.sim.control.clear()
    web.connected()
    web.front.enable()
    web.front.move_jp([0.06]).wait(LONG)


def test_writes_that_are_refused_are_told(web: SchunkBench) -> None:
    web.sim.control.inject("refuses")
    with pytest.raises(MotionAborted):
        web.front.move_jp([0.07]).wait(LONG)
    web.state(FAULT, "takes no commands")
    assert web.counter("refused") > 0
    assert not web.device.has_stopped, "that has not been read back"
    web.sim.control.clear("refuses")
    eventually(lambda: web.device.has_stopped, "stopped")


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"upper": 0.1}, "upper: 0.083"),
        ({"lower": -0.001}, "lower: 0"),
        ({"speed": 0.6}, "speed: 0.5"),
        ({"max_force": 200.0}, "max_force: 150"),
    ],
)
def test_what_it_cannot_do_is_refused_with_what_it_can(
    sim: RunningSim, values: dict[str, float], text: str
) -> None:
    other = SchunkBench(sim, configuration(sim, **values))
    other.session.start()
    try:
        assert text in other.state(FAULT, "cannot do")
    finally:
        other.front.close()


def test_a_profinet_module_has_big_numbers() -> None:
    with bench(simulated={"fieldbus": "profinet"}) as running:
        running.front.enable()
        assert running.front.move_jp([0.06]).wait(LONG)
        assert running.simulated("opening") == pytest.approx(0.06, abs=1e-4)
        notes = [note.text for note in running.front.health().notes]
        assert any("PROFINET" in text for text in notes)


@pytest.mark.slow
def test_a_simulator_that_is_killed_while_it_moves() -> None:
    with bench() as running:
        running.front.enable()
        running.front.trajectory_j.set_ratio(SLOW)
        move = running.front.move_jp([0.0])
        eventually(lambda: running.simulated("moves"), "it moves")
        os.kill(running.sim.pid, signal.SIGKILL)
        with pytest.raises(MotionAborted):
            move.wait(LONG)
        running.state(FAULT)


# ----------------------------------------------------------------------------------- bad commands
