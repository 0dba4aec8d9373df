"""The relay of a serial line: a device's pseudo terminal, and the kit's port where a driver has it."""

from __future__ import annotations

import os
import select
import time
import tty
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.kit.serial_port import SerialPort
from crtk_drivers.labs.bench.relay import Mode, RelayProcess
from crtk_drivers.plugins import DeviceLink
from rigs.waiting import LONG

SHORT = 0.2


@pytest.fixture
def device() -> Iterator[tuple[int, str]]:
    """A device's end of its line, and the name of the port."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    for end in (ours, theirs):
        with suppress(OSError):
            os.close(end)


@pytest.fixture
def relay(device: tuple[int, str]) -> Iterator[RelayProcess]:
    with RelayProcess(DeviceLink(serial={"bus": (device[1], 57_600)})) as made:
        yield made


def port_of(relay: RelayProcess) -> SerialPort:
    name, baud = relay.link.serial["bus"]
    return SerialPort(name, baud)


def heard(device: int, seconds: float) -> bytes:
    return os.read(device, 100) if select.select([device], [], [], seconds)[0] else b""


def told(port: SerialPort, seconds: float) -> bytes:
    return port.read(time.monotonic() + seconds)


def test_all_passes_both_ways_at_the_rate_of_the_device(
    relay: RelayProcess, device: tuple[int, str]
) -> None:
    every = bytes(range(256))  # no byte means anything to a terminal
    with port_of(relay) as port:
        assert port.baud == 57_600
        assert tty.tcgetattr(device[0])[4] == tty.B57600
        port.write(every)
        found = b""
        while len(found) < len(every):
            found += heard(device[0], LONG)
        assert found == every
        os.write(device[0], every)
        found = b""
        while len(found) < len(every):
            found += told(port, LONG)
        assert found == every


@pytest.mark.parametrize("mode", [Mode.DEAF, Mode.SILENT])
def test_what_does_not_pass_is_lost(
    relay: RelayProcess, device: tuple[int, str], mode: Mode
) -> None:
    with port_of(relay) as port:
        relay.mode = mode
        port.write(b"lost")
        os.write(device[0], b"told")
        assert told(port, LONG if mode is Mode.DEAF else SHORT) == (
            b"told" if mode is Mode.DEAF else b""
        )
        assert heard(device[0], SHORT) == b""
        relay.mode = Mode.OPEN
        port.write(b"again")
        assert heard(device[0], LONG) == b"again"


def test_closed_hangs_up_and_is_there_again_at_the_same_name(
    relay: RelayProcess, device: tuple[int, str]
) -> None:
    with port_of(relay) as port:
        relay.mode = Mode.CLOSED
        with pytest.raises(ConnectionLost):
            told(port, LONG)
        with pytest.raises(ConnectionFailed):
            port.open()
        relay.mode = Mode.OPEN
        port.open()
        port.write(b"again")
        assert heard(device[0], LONG) == b"again"


def test_a_device_that_is_gone_hangs_up(relay: RelayProcess, device: tuple[int, str]) -> None:
    with port_of(relay) as port:
        os.close(device[0])
        with pytest.raises(ConnectionLost):
            told(port, LONG)
    relay.mode = Mode.SILENT  # it still answers


def test_a_device_that_is_unplugged_while_it_is_closed_is_told(
    relay: RelayProcess, device: tuple[int, str]
) -> None:
    relay.mode = Mode.CLOSED
    with suppress(OSError):
        os.close(device[0])
    with pytest.raises(ConnectionFailed, match=r"the device is gone.*no such port"):
        relay.mode = Mode.OPEN
    relay.mode = Mode.SILENT  # it still answers


def test_a_driver_that_comes_back_finds_the_line(
    relay: RelayProcess, device: tuple[int, str]
) -> None:
    for _ in range(2):
        with port_of(relay) as port:
            port.write(b"x")
            assert heard(device[0], LONG) == b"x"


def test_a_port_that_is_not_there_is_told_and_its_names_are_gone(tmp_path: Path) -> None:
    with pytest.raises(ConnectionFailed, match=r"cannot open the device.*no such port"):
        RelayProcess(DeviceLink(serial={"bus": (str(tmp_path / "none"), 57_600)}))


def test_no_name_is_left(relay: RelayProcess) -> None:
    name = Path(relay.link.serial["bus"][0])
    assert name.is_symlink()
    relay.close()
    assert not name.parent.exists()
