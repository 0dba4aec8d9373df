"""Trajectories from messages in bytes, without ROS: known answers, and bytes that are no message."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.recording.cdr import Malformed
from crtk_drivers.recording.cdr_trajectories import GOAL_ID, decode_goal, decode_trajectory
from crtk_drivers.samples import MOST_POINTS


class Bytes:
    """Little-endian CDR, written here by hand."""

    def __init__(self) -> None:
        self.data = b""

    def put(self, kind: str, *values: float) -> Bytes:
        size = struct.calcsize("<" + kind[-1])
        self.data += bytes(-len(self.data) % size) + struct.pack("<" + kind, *values)
        return self

    def text(self, text: str) -> Bytes:
        self.put("I", len(text) + 1)
        self.data += text.encode() + b"\0"
        return self

    def doubles(self, *values: float) -> Bytes:
        self.put("I", len(values))
        for value in values:
            self.put("d", value)
        return self

    def trajectory(self) -> Bytes:
        """Two joints, two points, the second without velocities; stamp 7 s and 5 ns."""
        self.put("i", 7).put("I", 5).text("base").put("I", 2).text("elbow").text("wrist")
        self.put("I", 2)
        self.doubles(0.5, -0.5).doubles(0.1, 0.2).doubles().doubles().put("i", 0).put("I", 0)
        self.doubles(1.5, 1.0).doubles().doubles(3.0, 4.0).doubles().put("i", 2).put(
            "I", 500_000_000
        )
        return self

    def goal(self, multi_dof: str = "") -> Bytes:
        self.put("16B", *range(16)).trajectory()
        self.put("i", 0).put("I", 0).text("")
        if multi_dof:
            self.put("I", 1).text(multi_dof)
        else:
            self.put("I", 0)
        self.put("I", 0)  # no points of several degrees of freedom
        self.put("I", 1).text("wrist").put("d", 0.1).put("d", -1.0).put("d", 0.0)
        self.put("I", 0)
        self.put("I", 1).text("elbow").put("d", 0.0).put("d", 0.02).put("d", 0.0)
        self.put("I", 0)
        return self.put("i", 1).put("I", 250_000_000)

    @property
    def message(self) -> bytes:
        return b"\x00\x01\x00\x00" + self.data


def test_a_trajectory_is_read_as_it_was_written() -> None:
    read = decode_trajectory(Bytes().trajectory().message)
    assert read.name == ("elbow", "wrist")
    assert read.start_ns == 7_000_000_005
    assert read.times.tolist() == [0.0, 2.5]
    assert read.positions.tolist() == [[0.5, -0.5], [1.5, 1.0]]
    assert read.velocities[0].tolist() == [0.1, 0.2]
    assert np.isnan(read.velocities[1]).all()
    assert np.isnan(read.accelerations[0]).all()
    assert read.accelerations[1].tolist() == [3.0, 4.0]


def test_a_goal_has_its_tolerances_and_its_id() -> None:
    data = Bytes().goal().message
    assert data[GOAL_ID] == bytes(range(16))
    read = decode_goal(data)
    assert read.positions.tolist() == [[0.5, -0.5], [1.5, 1.0]]
    assert [(t.name, t.position, t.velocity) for t in read.path] == [("wrist", 0.1, -1.0)]
    assert [(t.name, t.position, t.velocity) for t in read.goal] == [("elbow", 0.0, 0.02)]
    assert read.goal_time == 1.25


def test_joints_of_several_degrees_of_freedom_are_no_goal_for_us() -> None:
    with pytest.raises(ValueError, match="several degrees of freedom"):
        decode_goal(Bytes().goal("base").message)


RAGGED = [
    ("one position for two joints", [(0.5, -0.5), (1.5,)], (), "point 1 has 1 positions"),
    ("half a velocity", [(0.5, -0.5)], (0.1,), "point 0 has 1 velocities"),
]


@pytest.mark.parametrize(("rows", "velocity", "told"), [row[1:] for row in RAGGED])
def test_vectors_that_do_not_fit_are_told(rows: object, velocity: object, told: str) -> None:
    data = Bytes().put("i", 0).put("I", 0).text("").put("I", 2).text("a").text("b")
    data.put("I", len(rows))  # type: ignore[arg-type]
    for index, row in enumerate(rows):  # type: ignore[var-annotated,arg-type]
        data.doubles(*row).doubles(*velocity).doubles().doubles().put("i", index).put("I", 0)  # type: ignore[misc]
    with pytest.raises(ValueError, match=told):
        decode_trajectory(data.message)


def test_efforts_are_not_followed() -> None:
    data = Bytes().put("i", 0).put("I", 0).text("").put("I", 1).text("a").put("I", 1)
    data.doubles(0.5).doubles().doubles().doubles(3.0).put("i", 0).put("I", 0)
    with pytest.raises(ValueError, match="efforts"):
        decode_trajectory(data.message)


@pytest.mark.parametrize("behind", [b"", bytes(64)])
@pytest.mark.parametrize("frame", [b"\xc3\x28\0", b"a\0b\0"])
def test_one_without_points_is_read_whatever_its_texts_are(frame: bytes, behind: bytes) -> None:
    data = Bytes().put("i", 0).put("I", 0).put("I", len(frame)).put(f"{len(frame)}B", *frame)
    data.put("I", 1).put("I", 2).put("2B", 0xFF, 0).put("I", 0)
    assert len(decode_trajectory(data.message + behind).times) == 0


def test_one_with_points_is_refused_for_its_frame() -> None:
    data = Bytes().put("i", 0).put("I", 0).put("I", 3).put("3B", 0xC3, 0x28, 0)
    data.put("I", 0).put("I", 1).doubles(0.5).doubles().doubles().doubles().put("i", 0).put("I", 0)
    with pytest.raises(Malformed, match="UTF-8"):
        decode_trajectory(data.message)


def test_more_points_than_are_taken_are_refused_before_any_is_read() -> None:
    data = Bytes().put("i", 0).put("I", 0).text("").put("I", 1).text("a").put("I", MOST_POINTS + 1)
    with pytest.raises(Malformed, match="points are more than"):
        decode_trajectory(data.message)


@given(st.integers(0, len(Bytes().goal().message) - 1))
def test_a_goal_that_was_cut_is_no_goal(length: int) -> None:
    with pytest.raises(ValueError, match=r"."):
        decode_goal(Bytes().goal().message[:length])


@given(st.binary(max_size=400), st.integers(0, 300))
def test_any_bytes_are_read_or_refused(noise: bytes, at: int) -> None:
    whole = Bytes().goal().message
    for data in (noise, b"\0\1\0\0" + noise, whole[:at] + noise + whole[at + len(noise) :]):
        for decode in (decode_goal, decode_trajectory):
            try:
                decode(data)
            except ValueError:
                continue


def test_points_that_leave_out_what_one_has_make_no_table_without_end() -> None:
    """A message of 3 MB that would be one of 20 GB."""
    made = Bytes()
    made.put("i", 0).put("I", 0).text("").put("I", 0).put("I", MOST_POINTS)
    made.doubles(*[0.0] * 50_000).doubles().doubles().doubles().put("i", 0).put("I", 0)
    made.data += bytes(24) * (MOST_POINTS - 1)
    with pytest.raises(Malformed, match="50000 points of 50000 joints"):
        decode_trajectory(b"\0\1\0\0" + made.data)
