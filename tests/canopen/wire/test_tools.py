"""The commands for people: scan and sdo."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from crtk_driver_canopen import tools
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.tools import ScanOptions, SdoOptions
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError, ConnectionFailed
from rigs.canopen_peer import ScriptedBus


@pytest.fixture
def peers() -> Iterator[ScriptedBus]:
    with ScriptedBus(1, 5) as bus:
        yield bus


@pytest.fixture
def config(peers: ScriptedBus) -> CanopenConfig:
    bus = {"interface": "virtual", "channel": peers.channel}
    return load(CanopenConfig, from_values({"bus": bus, "sdo_timeout": 10.0}))


@pytest.fixture
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tools._OUT, "width", 300, raising=False)


def run(config: CanopenConfig, **options: Any) -> int:
    return tools.sdo(config, load(SdoOptions, from_values(options)))


@pytest.mark.usefixtures("wide")
def test_scan_lists_nodes_with_identity_modes_and_state(
    peers: ScriptedBus, config: CanopenConfig, capsys: pytest.CaptureFixture[str]
) -> None:
    peers[5].types[0x603F, 0] = "H"
    peers[5].values |= {(0x603F, 0): 0x7305, (0x6041, 0): 0x0218}
    peers[5].types[0x6841, 0] = "H"
    peers[5].values[0x6841, 0] = 0x0237
    assert tools.scan(config, ScanOptions(seconds=1.0, last=20)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:3]] == ["1", "5"]
    assert "scripted servo drive" in lines[1]
    assert "0x1234 0x402 0x10002 1001" in lines[1]
    assert "pp pv hm csp csv" in lines[1]
    assert "switch on disabled" in lines[1]
    assert "fault, remote; incremental sensor 1 fault (0x7305)" in lines[2]
    assert lines[3].split()[0] == "1"
    assert "operation enabled" in lines[3]
    assert not any(peers[node].log or peers[node].commands for node in (1, 5))


def test_scan_of_an_empty_bus(config: CanopenConfig, capsys: pytest.CaptureFixture[str]) -> None:
    assert tools.scan(config, ScanOptions(first=30, last=40, seconds=0.05)) == 1
    assert "no node answers. Check power" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        ({"object": "6064"}, "6064h:00 position actual = 500 (0x000001f4)"),
        ({"object": "position actual"}, "= 500 (0x000001f4)"),
        ({"object": "statusword"}, "= 592 (0x0250): switch on disabled, remote"),
        ({"object": "1018:4", "type": "bytes"}, "= ed 03 00 00 (1005)"),
        ({"object": "1008"}, "= 'scripted servo drive'"),
        ({"object": "607A", "value": "-3"}, "= -3 (0xfffffffd)"),
        ({"object": "2000", "value": "0102ff"}, "= 01 02 ff (16712193)"),
        ({"object": "2000", "value": "hello", "type": "text"}, "= 'hello'"),
        ({"object": "6041", "type": "u32"}, "= 50 02"),
    ],
)
@pytest.mark.usefixtures("peers", "wide")
def test_objects_are_read_and_written(
    config: CanopenConfig, capsys: pytest.CaptureFixture[str], options: dict[str, str], shown: str
) -> None:
    assert run(config, node=5, **options) == 0
    assert shown in capsys.readouterr().out


@pytest.mark.usefixtures("wide")
def test_the_eds_of_the_joint_gives_names_and_types(
    peers: ScriptedBus, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheet = tmp_path / "drive.eds"
    sheet.write_text("[2000]\nParameterName=Motor label\nObjectType=7\nDataType=9\nAccessType=rw\n")
    joint = {"node": 5, "eds": str(sheet), "lower": 0, "upper": 1, "velocity": 1}
    bus = {"interface": "virtual", "channel": peers.channel}
    config = load(CanopenConfig, from_values({"bus": bus, "joints": {"a": joint}}))
    assert run(config, node=5, object="motor label", value="left") == 0
    assert "2000h:00 Motor label = 'left'" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"object": "positon_actual"}, "did you mean 'position_actual'"),
        ({"object": "6064", "type": "u7"}, "there is no type 'u7'.*u8"),
        ({"object": "607A", "value": "far"}, "'far' is no value for 607Ah:00 target position"),
        ({"object": "6040", "value": "65536"}, "does not fit into u16"),
        ({"object": "2000", "value": "xyz"}, "in hexadecimal"),
        ({"object": "6064", "eds": "/nonesuch.eds"}, "/nonesuch.eds: cannot be read"),
    ],
)
@pytest.mark.usefixtures("peers")
def test_what_cannot_be_meant_is_refused(
    config: CanopenConfig, options: dict[str, str], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        run(config, node=5, **options)


def test_a_bus_that_is_not_there() -> None:
    bus = {"interface": "crtk", "channel": "/nonesuch.sock"}
    config = load(CanopenConfig, from_values({"bus": bus}))
    with pytest.raises(ConnectionFailed, match=r"canopen crtk /nonesuch\.sock"):
        tools.scan(config, ScanOptions())
