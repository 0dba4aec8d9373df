"""Programs, pop-ups and the log by the UR driver, in both ways of control, at a simulated controller."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import pytest

from crtk_driver_ur import device
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionLost,
    DataTimeout,
    Reason,
    TransitionFailed,
)
from rigs.ur_bench import LONG, WAYS, UrBench, eventually, ur_bench

STOPPED, PLAYING = 1, 2
"""Values of `runtime_state`."""

MOVING = "def turn():\n  movej([0.4, -1.57, 1.57, -1.57, -1.57, 0.0], a=6, v=2)\n  sleep(60)\nend\n"


@pytest.fixture(scope="module", params=WAYS)
def shared(request, tmp_path_factory) -> Iterator[UrBench]:
    programs: Path = tmp_path_factory.mktemp("programs")
    (programs / "turn.script").write_text(MOVING)
    config = {"control": request.param, "power_off_on_disable": False}
    with ur_bench(config, programs=str(programs)) as bench:
        yield bench


@pytest.fixture
def bench(shared: UrBench) -> UrBench:
    if shared.arm.state.program_running() and shared.status.state != "ENABLED":
        shared.arm.stop_program(timeout=LONG)  # which a test that failed has left
    shared.reset()
    return shared


def problems(bench: UrBench) -> dict[str, str]:
    return {note.key: note.text for note in bench.engine.health().notes if note.severity > 0}


def shown(bench: UrBench) -> str | None:
    """Return what the teach pendant shows."""
    return bench.sim.control.status()["popup"]


def refused(call, reason: Reason, words: str) -> None:
    with pytest.raises(CommandRefused, match=words) as caught:
        call(timeout=LONG)
    assert caught.value.reason is reason


def load(bench: UrBench, name: str) -> None:
    bench.arm.load_program(name)
    eventually(lambda: bench.arm.state.loaded_program().endswith(name), f"{name} is loaded")


def test_a_program_is_loaded_played_paused_and_stopped_and_control_comes_back(bench):
    bench.arm.disable(timeout=LONG)
    load(bench, "turn.script")
    assert bench.arm.play_program(timeout=LONG) == "Starting program"
    eventually(lambda: bench.q()[0] > 0.2, "the program moves the arm")
    assert bench.arm.pause_program(timeout=LONG) == "Pausing program"
    eventually(lambda: bench.arm.state.program() == "PAUSED", "paused")
    assert bench.arm.play_program(timeout=LONG) == "Starting program"
    eventually(lambda: abs(bench.q()[0] - 0.4) < 1e-3, "it goes on")
    eventually(lambda: bench.arm.state.program_running() is True, "told")
    with (
        patch.object(device, "OTHER_PROGRAM_TIMEOUT", 0.2),  # it never ends
        pytest.raises(CommandRefused, match="another program"),
    ):
        bench.arm.enable(timeout=LONG)
    assert bench.arm.stop_program(timeout=LONG) == "Stopped"
    eventually(lambda: bench.arm.state.program_running() is False, "stopped")
    with bench.nothing_moves():
        bench.arm.enable(timeout=LONG)
    bench.go_home()


def test_what_would_take_control_away_is_refused(bench):
    with bench.nothing_moves():
        for service in ("play_program", "pause_program", "stop_program", "shut_down"):
            refused(getattr(bench.arm, service), Reason.INVALID_TRANSITION, "has control")
        for name in ("load_program", "load_installation"):
            with bench.refused(Reason.INVALID_TRANSITION, name):
                getattr(bench.arm, name)("simulation.urp")
    assert bench.status.state == "ENABLED"


def test_the_words_of_the_dashboard_are_the_reason(bench):
    bench.arm.disable(timeout=LONG)
    with pytest.raises(TransitionFailed, match="Failed to execute: pause"):
        bench.arm.pause_program(timeout=LONG)
    bench.arm.load_program("nowhere.urp")
    text = eventually(lambda: problems(bench).get("load_program"), "a note")
    assert "File not found: nowhere.urp" in text
    load(bench, "simulation.urp")
    eventually(lambda: problems(bench) == {}, "the note goes away")


def test_a_program_is_not_started_in_a_stop_nor_in_local_control(bench):
    bench.arm.disable(timeout=LONG)
    load(bench, "turn.script")
    bench.inject("local_control")
    with bench.nothing_moves():
        refused(bench.arm.play_program, Reason.LOCAL_CONTROL, "teach pendant")
        bench.arm.load_program("simulation.urp")
        text = eventually(lambda: problems(bench).get("load_program"), "a note")
    assert "Remote Control" in text
    eventually(lambda: bench.arm.state.remote_control() is False, "told")
    bench.sim.control.clear()
    eventually(lambda: bench.arm.state.remote_control() is True, "told")


def test_a_program_is_not_started_after_a_stop(bench):
    bench.arm.disable(timeout=LONG)
    load(bench, "turn.script")
    bench.inject("delay", port="dashboard", seconds=0.6, direction="in")
    with bench.nothing_moves():
        asked = bench.engine.request("play_program")
        bench.arm.hold()
        with pytest.raises(TransitionFailed, match="broken off: by hold"):
            asked.wait(LONG)
        bench.sim.control.clear()
        assert "STOPPED" in bench.arm.program_state(timeout=LONG), "nothing else was on its way"
    assert bench.arm.state.program_running() is False


@pytest.mark.slow
def test_a_stop_before_the_answer_ends_the_program_that_was_started(bench):
    bench.arm.disable(timeout=LONG)
    load(bench, "turn.script")
    bench.inject("delay", port="dashboard", seconds=1.0, direction="out")
    asked = bench.engine.request("play_program")
    bench.until_outputs(runtime_state=(PLAYING,))
    bench.arm.hold()
    with pytest.raises(TransitionFailed, match="broken off: by hold"):
        asked.wait(LONG)
    bench.until_outputs(runtime_state=(STOPPED,))
    bench.until_still()


def test_a_stop_in_the_very_step_of_the_answer_ends_the_program(bench, monkeypatch):
    bench.arm.disable(timeout=LONG)
    load(bench, "turn.script")
    services = bench.engine._requests._services
    play = services["play_program"]

    def play_and_stop():
        answer = yield from play.run()
        bench.engine.submit("hold")
        return answer

    monkeypatch.setitem(services, "play_program", replace(play, run=play_and_stop))
    assert bench.engine.request("play_program").wait(LONG) == "Starting program"
    assert "STOPPED" in bench.arm.program_state(timeout=LONG), "which is asked for after the stop"
    bench.until_outputs(runtime_state=(STOPPED,))
    bench.until_still()


def test_popup_and_log_reach_the_controller_in_any_state(bench):
    bench.arm.popup("mind the arm")
    eventually(lambda: shown(bench) == "mind the arm", "shown")
    bench.arm.close_popup(timeout=LONG)
    eventually(lambda: not shown(bench), "closed")
    bench.arm.add_to_log("run 7 begins")
    eventually(lambda: "addToLog run 7 begins" in str(bench.sim.control.status()), "noted")
    assert bench.status.state == "ENABLED"
    assert not problems(bench).keys() & {"popup", "add_to_log"}


@pytest.mark.parametrize("text", ["", "two\nlines", "x" * 1001])
def test_a_text_is_one_line(bench, text):
    with bench.refused(Reason.OUT_OF_RANGE, "popup"):
        bench.arm.popup(text)
    with bench.refused(Reason.WRONG_TYPE, "popup"):
        bench.arm.popup(7)


def test_answers(bench):
    assert bench.arm.serial_number(timeout=LONG).isdigit()
    assert "5.12" in bench.arm.polyscope_version(timeout=LONG)
    assert bench.arm.robot_model(timeout=LONG) == "UR5"
    assert bench.arm.operational_mode(timeout=LONG)
    assert "saved" in bench.arm.save_log(timeout=LONG)


def told(reading):
    """Return what a reading says, None while it is not known."""
    try:
        return reading()
    except DataTimeout:
        return None


def test_modes_stops_and_signals_are_readings(bench):
    state = bench.arm.state
    assert (state.robot_mode(), state.safety_mode()) == ("RUNNING", "NORMAL")
    assert (state.program(), state.program_running()) == ("PLAYING", True)
    bench.inject("digital_inputs", bits=1 << 3 | 1 << 8 | 1 << 16)
    eventually(lambda: state.digital_in_3() and state.configurable_in_0(), "the inputs")
    assert state.tool_in_0() is True
    assert state.digital_in_2() is False
    bench.sim.control.clear("digital_inputs")
    bench.arm.configurable_out_2(True)
    eventually(lambda: state.configurable_out_2(), "the output")
    bench.arm.configurable_out_2(False)
    bench.arm.analog_out_0_voltage(4.0)
    eventually(lambda: bench.outputs("standard_analog_output0") == pytest.approx(4.0), "4 V")
    eventually(lambda: told(state.analog_out_0_voltage) == pytest.approx(4.0), "4 V")
    with pytest.raises(DataTimeout, match="not known"):
        state.analog_out_0_current()
    assert state.speed_slider() == 1.0
    assert state.emergency_stop() is False
    bench.sim.control.inject("protective_stop")
    eventually(lambda: state.protective_stop(), "the stop")
    assert state.safety_mode() == "PROTECTIVE_STOP"


def test_shut_down_ends_the_controller():
    with ur_bench({"power_off_on_disable": False}) as bench:
        with suppress(ConnectionLost):  # the controller may be gone before its answer was read
            assert bench.arm.shut_down(timeout=LONG) == "Shutting down"
        bench.until_state("FAULT")
        eventually(lambda: bench.device.robot_state is None, "the link is lost")
        with pytest.raises(DataTimeout):
            bench.arm.state.robot_mode()
