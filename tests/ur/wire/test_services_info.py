"""`crtk-driver ur info`, and the calibration that it writes, against a simulated controller."""

import io
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import yaml
from rich.console import Console

from crtk_driver_ur import PLUGIN, tools
from crtk_driver_ur.primary import read_robot_info
from crtk_driver_ur.tools import InfoOptions, ask_dashboard, info
from crtk_drivers.config import from_file, from_values, load
from crtk_drivers.device import Severity
from crtk_drivers.errors import ConfigError, ConnectionFailed, ProtocolError, TransitionFailed
from crtk_drivers.samples import Pose, vector
from crtk_sim_backends.ur import SIM
from rigs.ur_bench import LONG, driver_at, eventually


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(model="ur10e", version="5.12.4", serial_number="20205512345") as sim:
        yield sim


@pytest.fixture
def said(monkeypatch) -> io.StringIO:
    text = io.StringIO()
    monkeypatch.setattr(tools, "_OUT", Console(file=text, width=200, highlight=False))
    return text


def rows_of(said: io.StringIO) -> dict[str, str]:
    """What was printed, by name."""
    return {line[:38].strip(): line[38:].strip() for line in said.getvalue().splitlines()}


def notes(bench):
    """Severity and text of what people should know, by name."""
    return {note.key: (note.severity, note.text) for note in bench.engine.health().notes}


def config(host: str, **values):
    return load(PLUGIN.config, from_values({"host": host, "model": "ur10e", **values}))


@contextmanager
def peer(data: bytes) -> Iterator[int]:
    """Listen on a free port, send `data` to whoever comes, and keep the connection open."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        connections: list[socket.socket] = []

        def serve() -> None:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            connections.append(connection)
            connection.sendall(data)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            thread.join(LONG)
            for connection in connections:
                connection.close()


def test_it_tells_what_the_arm_is(sim, said):
    sim.control.inject("digital_inputs", bits=5)
    try:
        inputs = {"actual_digital_input_bits": 5}
        eventually(lambda: sim.control.outputs(*inputs) == inputs, "they are set")
        assert info(config(sim.host), InfoOptions()) == 0
    finally:
        sim.control.clear("digital_inputs")
    rows = rows_of(said)
    assert rows["controller version"].startswith("5.12.4")
    assert rows["serial number"] == "20205512345"
    assert rows["model"] == "UR10"
    assert "not calibrated" in rows["compared"]
    assert rows["checked"].startswith("0.000 mm")
    assert rows["robot mode"] == "RUNNING"
    assert rows["safety mode"] == "NORMAL"
    assert rows["digital inputs"] == "0, 2"
    assert rows["payload (kg)"] == "0"
    assert rows["remote control"] == "true"
    assert rows["loaded program"] == "none"
    ask_dashboard(sim.host, ["load simulation.urp"])
    assert info(config(sim.host), InfoOptions()) == 0
    assert rows_of(said)["loaded program"] == "/programs/simulation.urp"


def test_another_model_than_is_configured_is_told(sim, said):
    assert info(config(sim.host, model="ur5e"), InfoOptions()) == 0
    assert "do not agree" not in said.getvalue()  # the calibration is the arm's, not the model's
    assert "from where the nominal ur5e has it" in said.getvalue()


def test_the_arm_moves_with_the_calibration_that_was_written(sim, said, tmp_path):
    path = tmp_path / "arm.yaml"
    assert info(config(sim.host), InfoOptions(output=str(path))) == 0
    assert "written" in said.getvalue()
    written = load(PLUGIN.config, from_file(path))
    assert (written.host, written.model) == (sim.host, "ur10e")
    with driver_at(sim, yaml.safe_load(path.read_text(encoding="utf-8"))) as bench:
        assert "calibration" not in notes(bench)
        bench.arm.enable(timeout=LONG)
        start = bench.arm.measured_cp()
        goal = start.position + np.array([0.0, 0.05, 0.05])
        for share in np.linspace(0.0, 1.0, 150):
            position = (1.0 - share) * start.position + share * goal
            bench.arm.servo_cp(Pose(vector(position), start.orientation, start.frame_id))
            time.sleep(0.004)
        eventually(
            lambda: np.allclose(bench.arm.measured_cp().position, goal, atol=1e-3), "it arrives"
        )
        assert bench.status.state == "ENABLED"


def test_a_calibration_of_another_arm_is_a_warning(sim):
    calibration = read_robot_info(sim.host, time.monotonic() + LONG).calibration
    values = {**calibration.model_dump(), "checksum": [1, 2, 3, 4, 5, 6]}
    with driver_at(sim, {"model": "ur10e", "calibration": values}) as bench:
        _, text = notes(bench)["calibration"]
        assert "has another one than is configured" in text
        assert "crtk-driver ur info" in text


@pytest.mark.parametrize("serial", ["20205512345", "20205512346"])
def test_an_arm_of_its_own_moves_by_the_calibration_that_it_tells(serial, said):
    with SIM.spawn(model="ur10e", calibration=2.0, serial_number=serial) as sim:
        assert info(config(sim.host), InfoOptions()) == 0
        rows = rows_of(said)
        assert "from where the nominal ur10e has it" in rows["compared"]
        assert rows["checked"].startswith("0.000 mm")
        with driver_at(sim, {"model": "ur10e", "calibration": "nominal"}) as bench:
            arm, state = bench.arm, bench.device.robot_state
            away = arm.forward_kinematics(arm.measured_jp()).position - state.actual_TCP_pose[:3]
            assert np.abs(away).max() > 2e-4
            assert "calibration" not in notes(bench)
        with driver_at(sim, {"model": "ur10e"}) as bench:
            arm = bench.arm
            severity, text = notes(bench)["calibration"]
            assert severity == Severity.INFO
            assert "mm from the nominal ur10e" in text
            arm.enable(timeout=LONG)
            start = arm.measured_cp()
            here = arm.forward_kinematics(arm.measured_jp())
            np.testing.assert_allclose(here.position, start.position, atol=1e-9)
            position = start.position + np.array([0.0, 0.08, 0.08])
            goal = Pose(vector(position), start.orientation, start.frame_id)
            assert arm.move_cp(goal).wait(LONG)
            np.testing.assert_allclose(arm.measured_cp().position, goal.position, atol=2e-4)
            eventually(
                lambda: np.abs(arm.measured_cp().position - goal.position).max() < 1e-6,
                "it is there",
            )
            assert abs(arm.measured_cp().orientation @ goal.orientation) > 1.0 - 1e-9


def test_a_calibration_that_is_not_told_or_of_another_model_is_a_warning():
    with SIM.spawn(model="ur10e", calibration=1.0) as sim:
        sim.control.inject("silence", port="primary_read_only")
        with driver_at(sim, {"model": "ur10e"}) as bench:
            severity, text = notes(bench)["calibration"]
            assert severity == Severity.WARNING
            assert "not known" in text
        sim.control.clear()
        with driver_at(sim, {"model": "ur5e"}) as bench:
            severity, text = notes(bench)["calibration"]
            assert severity == Severity.WARNING
            assert "does not fit a ur5e" in text
            with pytest.raises(TransitionFailed, match="this is no ur5e"):
                bench.arm.enable(timeout=LONG)


@pytest.mark.parametrize(
    ("model", "version"), [("ur3", "3.15.8"), ("ur5e", "5.23.0"), ("ur3e", "10.9.0")]
)
def test_other_controllers(model, version, said):
    with SIM.spawn(model=model, version=version) as sim:
        assert info(config(sim.host, model=model), InfoOptions()) == 0
    assert version in said.getvalue()
    assert "not calibrated" in said.getvalue()


def test_polyscope_x_is_asked_by_its_robot_api(said):
    with SIM.spawn(version="10.14.0", robot_api=True, robot_api_port=0) as sim:
        values = {"model": "ur5e", "robot_api_port": sim.ports["robot_api"]}
        assert info(config(sim.host, **values), InfoOptions()) == 0
        rows = rows_of(said)
        assert rows["serial number"] == "20235500001"
        assert rows["model"] == "UR5e"
        assert rows["software"].startswith("10.14")
        assert rows["remote control"] == "true"
        assert "dashboard" not in rows
        said.truncate(0)
        assert info(config(sim.host, model="ur5e", robot_api_port=9), InfoOptions()) == 0
        assert "Robot API" in said.getvalue()


def test_a_controller_without_dashboard_is_no_error(said, sim):
    sim.control.inject("disconnect", port="dashboard", duration=LONG)
    try:
        assert info(config(sim.host), InfoOptions()) == 0
    finally:
        sim.control.clear("disconnect")
    assert "dashboard server cannot be asked" in said.getvalue()
    assert "robot mode" in said.getvalue()


def test_an_output_that_cannot_be_written_is_said_so(sim, said, tmp_path):
    with pytest.raises(ConfigError, match="cannot be written"):
        info(config(sim.host), InfoOptions(output=str(tmp_path / "no" / "arm.yaml")))


def test_nobody_there():
    with pytest.raises(ConnectionFailed, match="cannot be read"):
        read_robot_info("127.0.0.1", time.monotonic() + LONG, ports=(1, 2))
    with pytest.raises(ConnectionFailed, match="cannot be asked"):
        ask_dashboard("127.0.0.1", ["robotmode"], port=1)


def test_a_silent_peer_and_one_that_talks_something_else():
    with peer(b"") as port, pytest.raises(ConnectionFailed, match="cannot be read"):
        read_robot_info("127.0.0.1", time.monotonic() + 0.2, ports=(port,))
    with peer(b"HTTP/1.1 400 Bad Request\r\n\r\n") as port, pytest.raises(ProtocolError):
        read_robot_info("127.0.0.1", time.monotonic() + LONG, ports=(port,))


def test_the_second_port_is_tried(sim):
    found = read_robot_info(sim.host, time.monotonic() + LONG, ports=(1, 30001))
    assert found.version.startswith("5.12.4")


def test_it_disturbs_no_driver_and_needs_no_remote_control(sim, said):
    with driver_at(sim, {"model": "ur10e"}) as bench:
        bench.arm.enable(timeout=LONG)
        move = bench.arm.move_jp([0.6, -1.57, 1.57, -1.57, -1.57, 0.0])
        assert info(config(sim.host), InfoOptions()) == 0
        assert move.wait(LONG)
        assert bench.status.state == "ENABLED"
        bench.inject("local_control")
        try:
            assert info(config(sim.host), InfoOptions()) == 0
        finally:
            sim.control.clear("local_control")
    assert "remote control" in said.getvalue()
    assert "false" in said.getvalue()
