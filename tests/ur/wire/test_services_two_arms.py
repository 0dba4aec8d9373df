"""Two arms side by side in one process, one of them at a controller whose lower registers a fieldbus has."""

import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest

from rigs.ur_bench import HOME, LONG, UrBench, eventually, ur_bench

FIELDBUS = b",".join(
    f"input_{kind}_register_{i}".encode() for kind in ("int", "double") for i in range(24)
)


def claim(other: socket.socket, names: bytes) -> None:
    other.sendall(struct.pack(">HBH", 5, ord("V"), 2))
    assert other.recv(4) == b"\x00\x04V\x01"
    other.sendall(struct.pack(">HB", 3 + len(names), ord("I")) + names)
    assert other.recv(2048)[3] > 0


@pytest.fixture
def arms() -> Iterator[tuple[UrBench, UrBench]]:
    with (
        ur_bench({"upper_range_registers": True}) as left,
        socket.create_connection((left.sim.host, 30004), LONG) as fieldbus,
        ur_bench(model="ur10e", version="5.23.0") as right,
    ):
        claim(fieldbus, FIELDBUS)
        for bench in (left, right):
            bench.arm.enable(timeout=LONG)
        yield left, right


def test_each_does_what_it_was_told_and_no_fault_reaches_the_other(arms):
    left, right = arms
    goals = ([0.5, *HOME[1:]], [-0.6, *HOME[1:]])
    left.arm.payload_mass(1.0)
    moves = [bench.arm.move_jp(goal) for bench, goal in zip(arms, goals, strict=True)]
    left.arm.digital_out_1(True)
    right.arm.tool_out_0(True)
    for move in moves:
        assert move.wait(LONG)
    for bench, goal in zip(arms, goals, strict=True):
        np.testing.assert_allclose(bench.q(), goal, atol=1e-3)
    left.until_outputs(actual_digital_output_bits=(2,), payload=(1.0,))
    right.until_outputs(actual_digital_output_bits=(1 << 16,), payload=(0.0,))

    left.sim.control.inject("protective_stop")
    left.until_state("FAULT", "protective stop")
    move = right.arm.move_jp(HOME)
    assert "NORMAL" in left.arm.unlock_protective_stop(timeout=LONG)
    assert move.wait(LONG)
    assert right.status.state == "ENABLED"
    left.arm.enable(timeout=LONG)
    assert left.arm.move_jp(HOME).wait(LONG)
    eventually(lambda: left.outputs("payload") == 1.0, "the payload is sent again")
