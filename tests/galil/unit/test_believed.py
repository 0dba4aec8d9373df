"""Which data records a device believes: twice, overtaken, what cannot be, older than the answer to a stop."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import pytest

from crtk_driver_galil.config import GalilConfig
from crtk_driver_galil.controller import GalilController
from crtk_driver_galil.plugin import TYPICAL
from crtk_drivers.config import from_values, load
from rigs.waiting import LONG


def record(sample: int, position: int = 0) -> bytes:
    """A record of three axes of a 4143, which stand without power; A somewhere."""
    head = bytearray(82)
    struct.pack_into("<BBHH", head, 0, 0x87, 0b111, 190, sample & 0xFFFF)
    axes = [
        struct.pack("<HBB6iH", 1, 0, 1, place, place, 0, 0, 0, 0, 0) + bytes(6)
        for place in (position, 0, 0)
    ]
    return bytes(head) + b"".join(axes)


class Arm(GalilController):
    """One that is given records."""

    def __init__(self, *, sample: int = 0) -> None:
        super().__init__(load(GalilConfig, from_values(TYPICAL)))
        self.now = 100.0
        assert self.give(sample)

    def give(self, sample: int, position: int = 0, after: float = 0.004) -> bool:
        """Whether a record is taken, so many seconds after the one before."""
        self.now += after
        return self._records.take(record(sample, position), self.now) is not None


def test_records_that_come_together_are_taken_in_their_order() -> None:
    arm = Arm()
    assert arm.give(8, 20, 0.0)
    assert not arm.give(4, 10, 0.0)
    assert not arm.give(8, 20, 0.0)
    assert arm.give(12, 30, 0.0)
    assert arm.counters["lost records"] == 1


def test_one_that_cannot_be_is_not_confirmed_by_its_double() -> None:
    arm = Arm()
    assert not arm.give(4, 1_000_000)
    assert not arm.give(4, 1_000_000)
    assert arm.give(8, 10)


def test_two_that_cannot_be_and_differ_confirm_nothing() -> None:
    arm = Arm()
    assert not arm.give(4, 1_000_000)
    assert not arm.give(8, -1_000_000)
    assert arm.give(12, 10)
    assert not arm.give(16, 1_000_000)
    assert arm.give(20, 1_000_010)


def test_a_sample_number_that_cannot_be_leaves_no_gap() -> None:
    """A byte of it changed: those that follow are not taken for overtaken ones."""
    arm = Arm(sample=65_530)
    assert not arm.give(65_530 + 4 + 256)
    assert arm.give(65_530 + 8)
    assert arm.give(65_530 + 12)


def test_a_controller_that_was_not_heard_for_long_is_believed_again() -> None:
    arm = Arm()
    assert arm.give(900, after=0.9)
    assert not arm.give(30_000, after=29.1)
    assert arm.give(30_004)


def test_a_record_that_the_network_held_up_is_as_old_as_it_is() -> None:
    """It froze for 3 s, and delivers what it kept, oldest first: the first ones tell of long ago."""
    arm = Arm()
    made = arm.now
    assert arm.give(4, after=3.0)
    assert arm._records.heard == pytest.approx(made + 0.004, abs=1e-3)
    assert arm.give(500, after=0.0)
    assert arm._records.heard == pytest.approx(made + 0.5, abs=1e-3)
    assert not arm.give(2996, after=0.0)  # so far from the one before that it is told twice
    assert arm.give(3000, after=0.0)
    assert arm._records.heard == pytest.approx(arm.now, abs=4e-3)
    assert arm.give(3004)
    assert arm._records.heard == pytest.approx(arm.now, abs=1e-6)


class Wire(NamedTuple):
    """A controller whose records and answers a test sends."""

    arm: GalilController
    records: socket.socket
    client: tuple[str, int]
    commands: socket.socket

    def send(self, sample: int) -> None:
        self.records.sendto(record(sample), self.client)


@contextmanager
def at_a_peer() -> Iterator[Wire]:
    with (
        socket.create_server(("127.0.0.1", 0)) as door,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as records,
    ):
        records.bind(("127.0.0.1", 0))
        place = {"tcp_port": door.getsockname()[1], "udp_port": records.getsockname()[1]}
        config = load(GalilConfig, from_values({**TYPICAL, "host": "127.0.0.1", **place}))
        arm = GalilController(config)
        soon = time.monotonic() + LONG
        arm._commander.open(soon)
        arm._link.open(soon)
        arm._link.write(b"DR 4\r")
        _, client = records.recvfrom(16)
        with door.accept()[0] as commands:
            yield Wire(arm, records, client, commands)
        arm.close(power_off=False)


def test_a_record_that_was_held_up_is_stamped_as_old() -> None:
    with at_a_peer() as wire:
        made = []
        for sample in (4, 8):
            wire.send(sample)
            counted = wire.arm.exchange(time.monotonic() + LONG).counted
            assert counted is not None
            made.append(counted.stamp.monotonic)
            time.sleep(0.05)  # for which the network keeps the next one
        assert made[1] - made[0] == pytest.approx(0.004, abs=1e-3)


def test_a_record_that_came_before_the_answer_to_a_stop_tells_nothing_of_it() -> None:
    with at_a_peer() as wire:
        soon = time.monotonic() + LONG
        wire.arm.halt(aside=False)
        assert wire.commands.recv(16) == b"ST ABC\r"
        time.sleep(0.02)  # it is taken late, after this record was made
        wire.send(4)
        wire.commands.sendall(b":")
        assert wire.arm.exchange(soon).counted is not None
        assert not wire.arm.has_stopped
        sample = 4
        while not wire.arm.has_stopped:
            assert time.monotonic() < soon
            sample += 4
            wire.send(sample)
            wire.arm.exchange(time.monotonic() + 0.004)


def test_a_record_of_before_a_stop_that_comes_after_it_does_not_tell_that_it_was_carried_out() -> (
    None
):
    """The network keeps them, and delivers one by one what the axes were before the stop."""
    with at_a_peer() as wire:
        soon = time.monotonic() + LONG
        wire.send(4)
        assert wire.arm.exchange(soon).counted is not None
        wire.arm.halt(aside=False)
        wire.commands.sendall(b":")
        while wire.arm._commander.waiting:
            assert time.monotonic() < soon
            wire.arm.exchange(time.monotonic() + 0.004)
        time.sleep(0.05)
        wire.send(8)
        assert wire.arm.exchange(soon).counted is not None
        assert not wire.arm.has_stopped
