"""A force sensor on ROS that takes its orientation from the arm named in its configuration."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import WrenchStamped

import crtk_drivers.client
from crtk_driver_ati_netft import PLUGIN, tools
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.tools import CalibrateOptions
from crtk_driver_virtual import PLUGIN as VIRTUAL
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConnectionFailed, DataTimeout
from crtk_drivers.front import LocalDevice
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from rigs.loopback_node import serve
from rigs.netft_peer import Peer
from rigs.ros_client import RosClient
from rigs.waiting import LONG, eventually

ARM, SENSOR = "/test_netft_arm", "/test_netft_sensor"
MASS = 2.0
CENTER = np.array([0.01, -0.02, 0.06])
BIAS = np.array([1, -2, 3, 0.1, 0.2, -0.3])
VALUES = {
    "http": False,
    "profile": "netbox",
    "transport": "udp",
    "scale": {"counts_per_force": 1e6, "counts_per_torque": 1e6},
    "tool": {"mass": MASS},
    "arm": ARM,
    "rate": 100.0,
    "sample_timeout": 3.0,  # a busy machine is no fault
}


def carrier() -> AbstractContextManager[Any]:
    """The arm that carries the sensor, on ROS."""
    config = load(VIRTUAL.config, from_values({"rate": 100.0}))
    return serve(config, ARM, [], plugin=VIRTUAL)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def peer() -> Iterator[Peer]:
    with Peer() as peer:
        peer.rate = 1000.0
        yield peer


@pytest.fixture(scope="module")
def sensor(peer) -> Iterator[Any]:
    """The sensor as its users have it on ROS. Its driver was there before the arm."""
    values = {**VALUES, "host": peer.host, "rdt_port": peer.port}
    config = load(NetFtConfig, from_values(values))
    with (
        serve(config, SENSOR, [], plugin=PLUGIN),  # type: ignore[arg-type]
        crtk_drivers.client.connect(SENSOR) as client,
    ):
        client.add("measured_cf")
        client.raw.add("measured_cf")
        yield client


def known(sensor: Any) -> Any:
    """The load, None if there is no valid one now."""
    try:
        return sensor.measured_cf(age=0.1, wait=0.0)
    except DataTimeout:
        return None


def test_the_load_is_valid_while_the_arm_tells_its_pose_and_at_no_other_time(sensor, peer) -> None:
    pull = [0.0, 0.0, -9.80665 * MASS]
    peer.counts = (*(round(value * 1e6) for value in pull), 0, 0, 0)
    measured = sensor.raw.measured_cf
    eventually(lambda: np.allclose(measured(wait=LONG).force, pull, atol=1e-5), "the load")
    with pytest.raises(DataTimeout, match="measured_cf"):
        sensor.measured_cf(wait=0.3)
    for _ in range(2):  # it finds the arm, loses it, and finds it again
        with carrier() as (session, _):
            found = session.engine.feedback("measured_cp")
            assert found is not None
            pull = matrix_from_quaternion(found[0].orientation).T @ [0, 0, -9.80665 * MASS]
            peer.counts = (*(round(value * 1e6) for value in pull.tolist()), 0, 0, 0)

            def weightless() -> bool:
                load = known(sensor)
                return load is not None and np.allclose(load.vector, 0.0, atol=1e-3)

            eventually(weightless, "the weight is taken off")
        eventually(lambda: known(sensor) is None, "the load is not valid any more")
        assert sensor.raw.measured_cf(wait=LONG).force.any()


def test_bias_services_answer_and_a_bias_that_was_set_is_read_back(sensor, peer) -> None:
    with RosClient(SENSOR) as client:
        refused = client.trigger("bias")
        assert not refused.success
        assert "the orientation of the sensor is not known" in refused.message
        sender = client.node.create_publisher(WrenchStamped, f"{SENSOR}/set_bias", 10)
        message = WrenchStamped()
        message.wrench.force.x = 7.0

        def is_set() -> bool:
            sender.publish(message)
            return "[7, 0, 0] N" in client.trigger("get_bias").message

        eventually(is_set, "the bias is set")
        assert client.trigger("unbias").success
        with carrier():
            eventually(lambda: client.trigger("bias").success, "the arm is found, and the bias set")
        assert "[0, 0, 0] N," not in client.trigger("get_bias").message
        assert client.trigger("unbias").success
        assert "[0, 0, 0] N," in client.trigger("get_bias").message
        refused = client.trigger("record_start")
        assert "no directory" in refused.message


class Operator(io.StringIO):
    """Moves the arm to the next pose each time that Enter is waited for; the tool hangs as it must."""

    def __init__(self, arm: Any, peer: Peer, goals: list[list[float]]) -> None:
        super().__init__()
        self._arm = arm
        self._peer = peer
        self._goals = iter(goals)

    def readline(self, *_: Any) -> str:
        arm = self._arm
        arm.move_jp(next(self._goals)).wait(LONG)
        turned = matrix_from_quaternion(arm.measured_cp().orientation)
        pull = turned.T @ [0, 0, -9.80665 * MASS]
        torque = np.cross(CENTER, pull)
        load = np.concatenate((pull, torque)) + BIAS
        self._peer.counts = tuple(round(value * 1e6) for value in load.tolist())
        sent = self._peer.sent
        eventually(lambda: self._peer.sent > sent + 100, "the load is measured, and all else over")
        return "\n"


@pytest.mark.slow  # test_orientation.py has it without ROS
def test_the_command_that_calibrates_takes_the_orientations_of_the_arm(
    peer, monkeypatch, tmp_path, capfd
) -> None:
    with Peer() as other, carrier() as (session, _), LocalDevice(session) as arm:
        other.rate = 1000.0
        values = {**VALUES, "tool": None, "host": other.host, "rdt_port": other.port}
        values["open_timeout"] = LONG
        config = load(NetFtConfig, from_values(values))
        arm.enable()
        start = arm.measured_jp()
        turns = [[0, 0, 0], [0, -1.2, 0.4], [1.2, -0.3, -0.6], [-1.2, -0.9, 1.0]]
        goals = [(start + np.concatenate((np.zeros(3), turn))).tolist() for turn in turns]
        monkeypatch.setattr("sys.stdin", Operator(arm, other, goals))
        result = tmp_path / "tool.yaml"
        options = CalibrateOptions(seconds=0.2, count=4, output=str(result))
        assert tools.calibrate(config, options) == 0
    assert "pose 4 of 4: as the arm holds it" in capfd.readouterr().out
    found = yaml.safe_load(result.read_text())
    assert found["tool"]["mass"] == pytest.approx(MASS, rel=1e-2)
    assert found["tool"]["center_of_mass"] == pytest.approx(CENTER.tolist(), abs=2e-3)
    assert found["bias"] == pytest.approx(BIAS.tolist(), abs=0.1)


def test_the_command_that_calibrates_says_when_there_is_no_arm(peer) -> None:
    values = {**VALUES, "tool": None, "host": peer.host, "rdt_port": peer.port}
    values |= {"arm": "/test_netft_nobody", "open_timeout": 1.5}  # the arm is waited for in vain
    with pytest.raises(ConnectionFailed, match="the orientation of the sensor is not known"):
        tools.calibrate(load(NetFtConfig, from_values(values)), CalibrateOptions(ask=False))
