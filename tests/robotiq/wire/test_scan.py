"""Grippers and force sensors are found by asking, and nothing of them changes."""

from __future__ import annotations

import contextlib
import socket
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from crtk_driver_robotiq import finding
from crtk_driver_robotiq.finding import GRIPPERS
from crtk_driver_robotiq.ft300 import finding as finding_sensors
from crtk_driver_robotiq.ft300.finding import SENSORS
from crtk_drivers.cli import main
from crtk_drivers.errors import ConnectionFailed, ProtocolError
from crtk_drivers.labs import load_lab
from crtk_sim_backends.robotiq import SIM, RunningSim
from crtk_sim_backends.robotiq.ft300 import SIM as FT300
from rigs.robotiq_bench import FREE_PORTS

SENSOR_PORTS = {"tool_port": 0, "modbus_port": 0}


@pytest.fixture(scope="module")
def gripper() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS, unit=9) as sim:
        yield sim


@pytest.fixture(scope="module", params=[False, True], ids=["silent", "streaming"])
def sensor(request: pytest.FixtureRequest) -> Iterator[RunningSim]:
    with FT300.spawn(**SENSOR_PORTS, streams=request.param) as sim:
        yield sim


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for who is there for longer than anybody is held up."""
    for module in (finding, finding_sensors):
        monkeypatch.setattr(module, "PATIENCE", 0.4)
    monkeypatch.setattr(finding_sensors, "LISTENING", 0.5)


def places(sim: RunningSim) -> dict[str, str]:
    return {
        "serial": sim.ttys["serial"],
        "tool": f"socket://{sim.host}:{sim.ports['tool']}",
        "modbus": f"modbus://{sim.host}:{sim.ports['modbus']}",
    }


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("way", ["serial", "tool", "modbus"])
def test_a_gripper_is_found_on_each_way(gripper: RunningSim, way: str) -> None:
    place = places(gripper)[way]
    assert GRIPPERS.takes(place)
    before = gripper.control.status()["writes"]
    (found,) = GRIPPERS.look(place)
    assert "Robotiq gripper, address 9, done" in found.told
    modbus = {"link": "modbus", "host": gripper.host, "tcp_port": gripper.ports["modbus"]}
    assert dict(found.settings) == (modbus if way == "modbus" else {"port": place})
    assert gripper.control.status()["writes"] == before


@pytest.mark.usefixtures("patient")
def test_one_at_another_address_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(finding, "ADDRESSES", range(16, 19))
    with SIM.spawn(**FREE_PORTS, unit=17) as sim:
        (found,) = GRIPPERS.look(places(sim)["tool"])
    assert found.settings["address"] == 17


@pytest.mark.usefixtures("patient")
def test_a_sensor_is_found_and_goes_on_to_do_what_it_did(sensor: RunningSim) -> None:
    streams = sensor.control.status()["streams"]
    for way in ("serial", "tool"):
        (found,) = SENSORS.look(places(sensor)[way])
        assert found.told == (
            "FT 300 that streams"
            if streams
            else "FT 300, serial FTS-0815, firmware FT1.05, of 2021"
        )
        assert sensor.control.status()["streams"] is streams
    assert len(list(SENSORS.look(places(sensor)["modbus"]))) == (0 if streams else 1)


def test_neither_is_taken_for_the_other(
    gripper: RunningSim, sensor: RunningSim, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(finding, "ADDRESSES", range(8, 11))
    assert not list(SENSORS.look(places(gripper)["tool"]))
    assert not list(GRIPPERS.look(places(sensor)["serial"]))


def test_where_nobody_listens_that_is_told() -> None:
    with pytest.raises(ConnectionFailed):
        list(GRIPPERS.look("/dev/no-such-port"))


@pytest.fixture
def flood() -> Iterator[int]:
    """The port of a server that sends without end; each accepted peer is served until it leaves."""
    peers: list[socket.socket] = []

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                peer, _ = server.accept()
                peers.append(peer)
                with contextlib.suppress(OSError):
                    while True:
                        peer.sendall(bytes(65536))

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve)
        thread.start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)
        thread.join()
    for peer in peers:
        peer.close()


@pytest.mark.parametrize("kind", ["socket", "modbus"])
def test_nobody_is_looked_for_where_bytes_come_without_end(flood: int, kind: str) -> None:
    with pytest.raises(ProtocolError, match="no Modbus"):
        list(GRIPPERS.look(f"{kind}://127.0.0.1:{flood}"))


@pytest.mark.usefixtures("patient")
def test_the_command_tells_what_to_type(
    gripper: RunningSim, capsys: pytest.CaptureFixture[str]
) -> None:
    port = gripper.ttys["serial"]
    assert main(["robotiq", "scan", "--port", port]) == 0
    told = capsys.readouterr().out
    assert f"crtk-driver robotiq --port {port}" in told
    where = ["--link", "modbus", "--host", gripper.host, "--tcp-port"]
    assert main(["robotiq", "scan", *where, str(gripper.ports["modbus"])]) == 0


@pytest.mark.usefixtures("patient")
def test_both_are_in_the_file_of_a_lab(
    gripper: RunningSim, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(finding, "ADDRESSES", range(9, 10))
    path = tmp_path / "lab.toml"
    with FT300.spawn(**SENSOR_PORTS) as sensor:
        at = ["--at", places(gripper)["tool"], "--at", places(sensor)["tool"]]
        assert main(["lab", "new", str(path), "--scan", *at]) == 0
    devices: dict[str, Any] = tomllib.loads(path.read_text())["devices"]
    assert list(devices) == ["robotiq", "robotiq_ft300"]
    assert load_lab(path).devices["robotiq_ft300"].config.port == places(sensor)["tool"]
