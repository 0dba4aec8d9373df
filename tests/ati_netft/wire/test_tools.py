"""The commands for people: info, configure, calibrate."""

from __future__ import annotations

import io
import re
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from crtk_driver_ati_netft import PLUGIN, tools
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.device import NetFtDevice
from crtk_driver_ati_netft.tools import UPWARDS, CalibrateOptions, InfoOptions
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError, ConnectionFailed, DeviceFault
from crtk_drivers.samples import Sample
from rigs.netft_peer import Peer
from rigs.waiting import eventually

MASS, CENTER = 0.8, np.array([0.01, -0.02, 0.06])
BIAS = np.array([1, -2, 3, 0.1, 0.2, -0.3])
HELD_STILL = 100
"""Records of a pose before Enter is pressed."""


@pytest.fixture
def peer() -> Iterator[Peer]:
    with Peer() as peer:
        peer.rate = 1000.0
        yield peer


@pytest.fixture
def config(peer) -> NetFtConfig:
    values = {
        "host": peer.host,
        "rdt_port": peer.port,
        "http": False,
        "profile": "netbox",
        "transport": "udp",
        "scale": {"counts_per_force": 1e6, "counts_per_torque": 1e6},
        "sample_timeout": 1.0,
    }
    return load(NetFtConfig, from_values(values))


class Hand(io.StringIO):
    """Turns the sensor to the next pose, and holds it still, each time that Enter is waited for."""

    def __init__(self, peer: Peer, rotations: list[np.ndarray]) -> None:
        super().__init__()
        self._peer = peer
        self._rotations = iter(rotations)

    def readline(self, *_: Any) -> str:
        pull = next(self._rotations).T @ [0, 0, -9.80665 * MASS]
        load = np.concatenate((pull, np.cross(CENTER, pull))) + BIAS
        self._peer.counts = tuple(round(value * 1e6) for value in load)
        # When a record was measured is known as well as the first ones came in time.
        held = self._peer.sent + HELD_STILL
        eventually(lambda: self._peer.sent > held, "it is held still")
        return "\n"


def test_the_tools_are_commands() -> None:
    assert [tool.name for tool in PLUGIN.tools] == ["info", "configure", "calibrate", "record"]


def test_info_tells_load_and_rates(config, peer, capsys) -> None:
    peer.counts = (1500000, 0, 0, 0, 0, -250000)
    assert tools.info(config, InfoOptions(seconds=0.1)) == 0
    text = capsys.readouterr().out
    assert "netbox" in text
    assert "1.5 ± 0 N" in text
    assert "-0.25 ± 0 N·m" in text
    assert re.search(r"^arrival jitter p99 +[\d.e-]+ (ms|s) *$", text, re.MULTILINE)
    assert re.search(r"^tick rate +\d+(\.\d+)? Hz *$", text, re.MULTILINE)
    peer.wait_for(0)


def test_who_is_held_up_looks_once_more(config, peer, monkeypatch, capsys) -> None:
    read, held_up = NetFtDevice.read, [1.2 * config.sample_timeout]

    def read_late(device: NetFtDevice, deadline: float) -> Sample | None:
        if held_up:
            time.sleep(held_up.pop())
            return None
        return read(device, deadline)

    monkeypatch.setattr(NetFtDevice, "read", read_late)
    assert tools.info(config, InfoOptions(seconds=0.1)) == 0


def test_info_leaves_the_stream_alone_when_told_to(config, peer, capsys) -> None:
    assert tools.info(config, InfoOptions(seconds=0.0)) == 0
    assert "1e+06, 1e+06" in capsys.readouterr().out
    assert peer.requests == []


def test_info_fails_when_there_is_no_sensor(config) -> None:
    with pytest.raises(ConnectionFailed):
        tools.info(config.model_copy(update={"rdt_port": 9, "open_timeout": 0.2}), InfoOptions())


def test_calibrate_asks_for_six_poses_and_finds_the_tool(
    config, peer, monkeypatch, tmp_path, capsys
) -> None:
    monkeypatch.setattr("sys.stdin", Hand(peer, list(UPWARDS.values())))
    result, picture = tmp_path / "tool.yaml", tmp_path / "residuals.svg"
    options = CalibrateOptions(seconds=0.1, output=str(result), plot=str(picture))
    assert tools.calibrate(config, options) == 0
    text = capsys.readouterr().out
    assert "pose 6 of 6: the sensor's -y axis upwards" in text
    assert "0.8000 ± 0.0000 kg" in text
    found = yaml.safe_load(result.read_text())
    assert found["tool"]["mass"] == pytest.approx(MASS, abs=1e-5)
    assert found["tool"]["center_of_mass"] == pytest.approx(CENTER.tolist(), abs=1e-5)
    assert found["bias"] == pytest.approx(BIAS.tolist(), abs=1e-5)
    load(NetFtConfig, from_values({**found, "host": "192.168.1.1"}))
    drawn = ET.fromstring(picture.read_text())
    assert len(drawn.findall(".//{*}rect")) == 1 + 6 * 6


def test_calibrate_takes_poses_from_a_file(config, peer, monkeypatch, tmp_path, capsys) -> None:
    half = np.sqrt(0.5)
    quaternions = [(0, 0, 0, 1), (1, 0, 0, 0), (half, 0, 0, half), (0, half, 0, half)]
    lines = [" ".join(map(str, q)) for q in quaternions]
    file = tmp_path / "poses.txt"
    file.write_text("# x y z w\n\n" + "\n".join(lines).replace(" ", ", ") + "  # the last\n")
    rotations = list(tools._poses_of(str(file)).values())
    assert len(rotations) == 4
    assert rotations[1] == pytest.approx(np.diag((1.0, -1.0, -1.0)))
    monkeypatch.setattr("sys.stdin", Hand(peer, rotations))
    assert tools.calibrate(config, CalibrateOptions(seconds=0.1, poses=str(file))) == 0
    assert "0.8000 ± 0.0000 kg" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("content", "message"),
    [("1 2 3", "poses.txt:1"), ("0 0 0 1\n0 0 0 2", "poses.txt:2"), ("a b c d", "poses.txt:1")],
)
def test_poses_that_are_none_are_refused_with_their_line(
    config, tmp_path, content, message
) -> None:
    file = tmp_path / "poses.txt"
    file.write_text(content)
    with pytest.raises(ConfigError) as caught:
        tools.calibrate(config, CalibrateOptions(poses=str(file)))
    assert message in str(caught.value)
    with pytest.raises(ConfigError, match="cannot be read"):
        tools.calibrate(config, CalibrateOptions(poses=str(tmp_path / "nothing")))


def test_calibrate_says_when_nothing_can_be_found(config, peer) -> None:
    with pytest.raises(ConfigError, match="no tool can be found"):
        tools.calibrate(config, CalibrateOptions(seconds=0.05, ask=False))


def test_calibrate_gives_up_on_a_sensor_in_error(config, peer, monkeypatch) -> None:
    peer.status = 0x80000004
    with pytest.raises(DeviceFault, match="temperature"):
        tools.calibrate(config, CalibrateOptions(seconds=0.2, ask=False))


def test_the_poses_that_are_asked_for_are_rotations_with_that_axis_upwards() -> None:
    for name, rotation in UPWARDS.items():
        assert rotation @ rotation.T == pytest.approx(np.eye(3))
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        up = np.zeros(3)
        up["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
        assert rotation @ up == pytest.approx([0, 0, 1])


def test_results_that_cannot_be_written_are_told(config, peer, monkeypatch, tmp_path) -> None:
    monkeypatch.setattr("sys.stdin", Hand(peer, list(UPWARDS.values())))
    with pytest.raises(ConfigError, match="cannot be written"):
        tools.calibrate(
            config, CalibrateOptions(seconds=0.05, plot=str(Path(tmp_path) / "a" / "b"))
        )
