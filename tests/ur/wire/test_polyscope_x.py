"""The UR driver at PolyScope X: the Robot API in place of the dashboard, in both ways of control."""

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from crtk_driver_ur.dashboard import REQUESTS as DASHBOARD
from crtk_driver_ur.robot_api import REQUESTS, RobotApiClient
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    ConnectionLost,
    Reason,
    TransitionFailed,
)
from rigs.ur_bench import HOME, LONG, WAYS, UrBench, brisk_sim, driver_at, eventually

LATEST = (10, 14)


@pytest.fixture(scope="module")
def sim(tmp_path_factory) -> Iterator:
    programs: Path = tmp_path_factory.mktemp("programs")
    (programs / "wait.script").write_text("def waiting():\n  sleep(60)\nend\n")
    with brisk_sim(
        version="10.14",
        robot_api=True,
        robot_api_port=0,
        programs=str(programs),
        trace_size=2000,
    ) as sim:
        yield sim


@pytest.fixture(scope="module", params=WAYS)
def shared(request, sim) -> Iterator[UrBench]:
    config = {
        "control": request.param,
        "robot_api_port": sim.ports["robot_api"],
        "power_off_on_disable": False,
    }
    with driver_at(sim, config) as bench:
        yield bench


@pytest.fixture
def bench(shared: UrBench) -> UrBench:
    shared.reset()
    return shared


def test_power_goes_up_and_down_and_the_arm_moves(bench):
    assert bench.arm.move_jp([0.3, *HOME[1:]]).wait(LONG)
    bench.arm.disable(timeout=LONG)
    assert bench.arm.power_off(timeout=LONG) == "POWER_OFF"
    assert bench.arm.power_on(timeout=LONG) == "IDLE"
    assert bench.arm.brake_release(timeout=LONG) == "RUNNING"
    bench.enable()
    bench.go_home()


def test_programs(bench):
    bench.arm.disable(timeout=LONG)
    bench.arm.load_program("wait")
    eventually(lambda: bench.arm.state.loaded_program() == "wait", "loaded")
    bench.arm.play_program(timeout=LONG)
    eventually(lambda: bench.arm.state.program_running(), "it runs")
    assert bench.arm.program_state(timeout=LONG) == "PLAYING"
    bench.arm.pause_program(timeout=LONG)
    eventually(lambda: bench.arm.state.program() == "PAUSED", "paused")
    bench.arm.play_program(timeout=LONG)
    eventually(lambda: bench.arm.state.program() == "PLAYING", "it goes on")
    bench.arm.stop_program(timeout=LONG)
    eventually(lambda: not bench.arm.state.program_running(), "it has ended")
    with pytest.raises(TransitionFailed, match="not possible"):
        bench.arm.pause_program(timeout=LONG)
    bench.arm.load_program("nowhere")
    notes = bench.engine.health
    eventually(
        lambda: any("no program nowhere" in note.text for note in notes().notes), "the reason"
    )


def test_pop_ups_log_and_answers(bench):
    bench.arm.popup("mind the arm")
    eventually(lambda: bench.sim.control.status()["popup"] == "mind the arm", "shown")
    assert bench.arm.close_popup(timeout=LONG) == "closed"
    assert bench.sim.control.status()["popup"] is None
    assert bench.arm.close_safety_popup(timeout=LONG) == "closed"
    bench.arm.add_to_log("run 7")
    assert bench.arm.serial_number(timeout=LONG) == "20235500001"
    assert bench.arm.robot_model(timeout=LONG) == "UR5e"
    assert bench.arm.polyscope_version(timeout=LONG).startswith("10.14")
    assert bench.arm.operational_mode(timeout=LONG) == "AUTOMATIC"


def test_the_pendant_keeps_control(bench):
    bench.inject("local_control")
    bench.until_state("PAUSED")
    for service in ("power_off", "close_popup"):
        with pytest.raises(CommandRefused) as caught:
            getattr(bench.arm, service)(timeout=LONG)
        assert caught.value.reason in (Reason.LOCAL_CONTROL, Reason.INVALID_TRANSITION)
    eventually(lambda: bench.arm.state.remote_control() is False, "it is told")


def test_what_it_does_not_offer_is_refused_with_the_reason(bench):
    with pytest.raises(TransitionFailed, match="save_log: PolyScope X does not offer it"):
        bench.arm.save_log(timeout=LONG)


# The client


def test_every_request_is_one_of_the_dashboard():
    assert REQUESTS.keys() <= DASHBOARD.keys()


@pytest.mark.parametrize(
    ("version", "name", "words"),
    [
        ((10, 11), "popup", "needs PolyScope 10.14, and this is 10.11"),
        ((10, 9), "power_on", "needs PolyScope 10.11, and this is 10.9"),
        ((10, 14), "load_installation", "does not offer"),
    ],
)
def test_older_software_is_not_even_asked(version, name, words):
    with pytest.raises(TransitionFailed, match=words):
        RobotApiClient("127.0.0.1", 1, version).ask(name, {"text": "x"})


def test_the_first_version_loads_by_another_path_and_unlocks_when_its_time_is_over():
    with brisk_sim(version="10.11", robot_api=True, robot_api_port=0) as sim:
        client = RobotApiClient(sim.host, sim.ports["robot_api"], (10, 11))
        assert client.ask("load_program", {"text": "simulation"}) == "OK"
        sim.control.inject("protective_stop")
        eventually(lambda: sim.control.outputs("safety_mode")["safety_mode"] == 3, "the stop")
        assert client.ask("unlock_protective_stop") == "OK"
        assert sim.control.outputs("safety_mode")["safety_mode"] == 1


def test_nobody_there():
    with pytest.raises(ConnectionFailed, match="cannot connect"):
        RobotApiClient("127.0.0.1", 1, LATEST).ask("power_on")


class _Odd(BaseHTTPRequestHandler):
    body = b""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(len(self.body)))
        self.end_headers()
        self.wfile.write(self.body)

    def log_message(self, *arguments: object) -> None:
        pass


@pytest.mark.parametrize(
    ("body", "error", "words"),
    [
        (b"<html>", ConnectionLost, "no answer"),
        (b"[1]", TransitionFailed, "has no 'mode'"),
        (b'{"other": 1}', TransitionFailed, "has no 'mode'"),
        (b"\xff\xfe", ConnectionLost, "no answer"),
    ],
)
def test_an_answer_that_is_none(body, error, words):
    handler = type("Handler", (_Odd,), {"body": body})
    with HTTPServer(("127.0.0.1", 0), handler) as server:
        answering = threading.Thread(target=server.handle_request)
        answering.start()
        client = RobotApiClient("127.0.0.1", server.server_address[1], LATEST)
        with pytest.raises(error, match=words):
            client.ask("is_in_remote_control")
        answering.join(LONG)
