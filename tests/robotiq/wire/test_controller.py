"""Robotiq's own controller in Modbus TCP, and ports of a robot that a gripper is not to be looked for at."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from crtk_driver_robotiq import PLUGIN
from crtk_driver_robotiq.config import RobotiqConfig
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError, ConnectionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.kit import TcpTransport
from crtk_drivers.session import Session
from crtk_sim_backends.robotiq import SIM
from rigs.robotiq_bench import FREE_PORTS, bench, eventually

LONG = 10.0


def asked(peer: socket.socket, request: str) -> str:
    peer.sendall(bytes.fromhex(request))
    return peer.recv(256).hex(" ")


def test_the_examples_of_the_manual_are_answered() -> None:
    """2F-200 manual, 4.10: activate, read, close; function 3 and other addresses it does not know."""
    with (
        SIM.spawn(**FREE_PORTS, activated=False) as sim,
        socket.create_connection((sim.host, sim.ports["controller"]), LONG) as peer,
    ):
        activate = "33 9a 00 00 00 0d 02 10 00 00 00 03 06 01 00 00 00 00 00"
        assert asked(peer, activate) == "33 9a 00 00 00 06 02 10 00 00 00 03"
        look = "45 33 00 00 00 06 02 04 00 00 00 01"
        assert asked(peer, look) == "45 33 00 00 00 05 02 04 02 11 00"
        eventually(lambda: asked(peer, look).endswith("31 00"), "it is activated")
        assert asked(peer, "00 01 00 00 00 06 02 03 00 00 00 01").endswith("02 83 01")
        assert asked(peer, "00 01 00 00 00 06 02 04 07 d0 00 01").endswith("02 84 02")
        close = "71 ee 00 00 00 0d 02 10 00 00 00 03 06 09 00 00 ff 40 40"
        assert asked(peer, close) == "71 ee 00 00 00 06 02 10 00 00 00 03"
        assert sim.control.call("status")["written"] == "09 00 00 ff 40 40"


def test_a_gripper_at_its_own_controller_moves() -> None:
    with bench("controller") as run:
        assert run.config.address == 2
        run.front.enable(LONG)
        run.front.move_jp([0.02]).wait(LONG)
        assert run.simulated("opening") == pytest.approx(0.02, abs=1e-3)


def test_ports_of_a_robot_are_refused() -> None:
    """A robot takes what comes there for URScript."""
    for port in (30001, 30002, 30003, 30020):
        with pytest.raises(ConfigError, match="URScript"):
            load(
                RobotiqConfig, from_values({"link": "urcap", "host": "127.0.0.1", "tcp_port": port})
            )
        with pytest.raises(ConfigError, match="URScript"):
            load(RobotiqConfig, from_values({"port": f"socket://127.0.0.1:{port}"}))
        with pytest.raises(ConnectionFailed, match="URScript"):
            TcpTransport("127.0.0.1", port).open(0.0)


@contextmanager
def robot() -> Iterator[tuple[int, list[bytes]]]:
    """Somebody who tells his state at once, as a robot does, and keeps what he is sent."""
    heard: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    peer, _ = server.accept()
                except OSError:
                    return
                with peer:
                    peer.sendall(bytes(55))
                    heard.append(peer.recv(4096))

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield server.getsockname()[1], heard
        server.shutdown(socket.SHUT_RDWR)


def test_nothing_is_sent_to_who_speaks_first() -> None:
    with robot() as (port, heard):
        values = {"link": "urcap", "host": "127.0.0.1", "tcp_port": port}
        config = load(RobotiqConfig, from_values(values))
        arm = LocalDevice(Session(PLUGIN, config))
        try:
            arm._session.start()
            eventually(lambda: "before it is asked" in arm.operating_state().detail, "it is told")
            eventually(lambda: len(heard) > 0, "it has gone")
        finally:
            arm.close()
        assert set(heard) == {b""}


def test_the_end_of_its_connection_stops_the_fingers() -> None:
    """The manual: shutting down communication will stop the gripper."""
    with SIM.spawn(**FREE_PORTS) as sim:
        with socket.create_connection((sim.host, sim.ports["controller"]), LONG) as peer:
            asked(peer, "71 ee 00 00 00 0d 02 10 00 00 00 03 06 09 00 00 ff 00 00")
            assert sim.control.call("status")["written"].startswith("09")
        eventually(lambda: sim.control.call("status")["written"].startswith("01"), "it stops")
