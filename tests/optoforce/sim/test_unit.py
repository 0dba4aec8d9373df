"""The simulated unit alone, by bytes written down from the vendor's protocol."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Iterator

import pytest

from crtk_sim_backends.optoforce import SIM, RunningSim
from crtk_sim_backends.optoforce.unit import RATED, Unit
from rigs.waiting import LONG, eventually

CONFIGURE = bytes.fromhex("AA0032030A040000ED")
STOP = bytes.fromhex("AA00320300040000E3")


@pytest.fixture
def port() -> Iterator[tuple[int, RunningSim]]:
    with SIM.spawn(sensor="6-axis", noise=0.0) as sim:
        opened = os.open(sim.ttys["serial"], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        yield opened, sim
        os.close(opened)


def heard(port: int, wanted: bytes) -> bytes:
    """Return what is heard until it has `wanted`."""
    data, end = b"", time.monotonic() + LONG
    while wanted not in data:
        assert time.monotonic() < end, data[-100:].hex()
        if select.select([port], [], [], 0.1)[0]:
            data += os.read(port, 4096)
    return data


def test_it_sends_as_soon_as_it_is_there(port: tuple[int, RunningSim]) -> None:
    opened, sim = port
    sim.control.inject("load", fx=2.5, mz=-0.5)
    heard(opened, bytes.fromhex("03E8 0000 0000 0000 0000 FC18"))
    assert sim.control.status()["period"] == 10


def test_it_confirms_a_configuration_in_pieces_and_tells_who_it_is(
    port: tuple[int, RunningSim],
) -> None:
    opened, sim = port
    os.write(opened, b"\x00\xaa\x00" + CONFIGURE[:5])
    os.write(opened, CONFIGURE[5:])
    heard(opened, bytes.fromhex("AA0050010000FB"))
    os.write(opened, bytes.fromhex("AB00120800C5"))
    heard(opened, b"\xaa\x00\x12\x08ISE0A129")
    os.write(opened, CONFIGURE[:-1] + b"\xee" + bytes.fromhex("AB00120800C5"))
    heard(opened, b"\xaa\x00\x12\x08ISE0A129")
    assert sim.control.status()["configured"] == 1, "a wrong sum is no order"

    def is_stopped() -> bool:
        os.write(opened, STOP)  # refused if it comes too soon
        return bool(sim.control.status()["period"] == 0)

    eventually(is_stopped, "stopped")


def test_what_it_refuses() -> None:
    now = [0.0]
    unit = Unit("3-axis", 0.0, lambda: now[0])
    assert unit.configure(10, 4, 255) == 0
    now[0] = 0.001
    assert unit.configure(10, 4, 0) == 1, "too soon"
    now[0] = 0.01
    assert unit.configure(10, 4, 255) == 1, "it is zeroed"
    assert unit.configure(7, 4, 0) == 1
    assert unit.configure(10, 7, 0) == 1
    assert unit.configure(10, 4, 0) == 0


def test_beyond_its_range_it_says_so() -> None:
    unit = Unit("4x3-axis", 0.0)
    unit.configure(1, 0, 0)
    unit.loads[1] = [0.0, 100.0, 0.0, 0.0, 0.0, 0.0]
    measured = unit.advance()
    assert measured is not None
    number, status, counts = measured
    assert (number, status) == (1, 0x0102)
    assert counts[4] == RATED
