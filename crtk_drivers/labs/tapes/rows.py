"""A message as rows of a table: the numbers and words in it, by name; as bytes where it cannot be read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording import Message
from crtk_drivers.recording.cdr import Malformed
from crtk_drivers.recording.cdr_transforms import TYPE as TRANSFORMS
from crtk_drivers.recording.cdr_transforms import decode_transforms
from crtk_drivers.samples import (
    CartesianServo,
    Flag,
    JointServo,
    JointState,
    Number,
    Numbers,
    Pose,
    Poses,
    Text,
    Twist,
    Vector,
    Wrench,
)
from crtk_drivers.state import Status

Cell = float | str | bool
Row = dict[str, Cell]

TIMES: Final = ("log_time_ns", "publish_time_ns", "stamp_ns", "frame_id")
"""The first columns of each table; `stamp_ns` 0 is CRTK's mark of data that is not valid."""

_XYZ: Final = ("x", "y", "z")


def rows_of(message: Message) -> Iterator[tuple[int, str, Row]]:
    """Yield the same of each thing that a message holds: of transforms it has several, else it is one."""
    if message.type_name != TRANSFORMS:
        yield row_of(message)
        return
    try:
        transforms = decode_transforms(message.data)
    except Malformed:
        yield 0, "", {"data": message.data.hex()}
        return
    for each in transforms:
        yield each.stamp_ns, each.pose.frame_id, {"child_frame_id": each.child, **_pose(each.pose)}


def row_of(message: Message) -> tuple[int, str, Row]:
    """Return the stamp in ns, the frame, and what else a message says."""
    try:
        found = message.decoded()
    except RecordingError:
        return 0, "", {"data": message.data.hex()}
    make = _ROWS.get(type(found.value))
    row: Row = make(found.value) if make is not None else {"data": message.data.hex()}
    return found.stamp_ns, found.frame_id, row


def _joints(value: JointState | JointServo) -> Row:
    row: Row = {}
    for part in ("position", "velocity", "effort"):
        numbers = getattr(value, part).tolist()
        for index, number in enumerate(numbers):
            joint = value.name[index] if value.name else str(index)
            row[f"{part}/{joint}"] = number
    if isinstance(value, JointServo):
        row |= {f"mode/{index}": float(mode) for index, mode in enumerate(value.modes)}
    return row


def _named(prefix: str, names: tuple[str, ...], numbers: Vector) -> Iterator[tuple[str, float]]:
    for name, number in zip(names, numbers.tolist(), strict=True):
        yield f"{prefix}/{name}", number


def _pose(value: Pose) -> Row:
    turned = _named("orientation", (*_XYZ, "w"), value.orientation)
    return dict([*_named("position", _XYZ, value.position), *turned])


def _poses(value: Poses) -> Row:
    rows = [(index, _pose(pose)) for index, pose in enumerate(value.poses)]
    return {f"{index}/{name}": cell for index, row in rows for name, cell in row.items()}


def _twist(value: Twist) -> Row:
    return dict([*_named("linear", _XYZ, value.linear), *_named("angular", _XYZ, value.angular)])


def _wrench(value: Wrench) -> Row:
    return dict([*_named("force", _XYZ, value.force), *_named("torque", _XYZ, value.torque)])


def _cartesian(value: CartesianServo) -> Row:
    modes = {f"mode/{index}": float(mode) for index, mode in enumerate(value.modes)}
    task = {f"task/{name}": cell for name, cell in _pose(value.task).items()}
    return {**modes, **task, **_pose(value.pose), **_twist(value.twist), **_wrench(value.wrench)}


def _status(value: Status) -> Row:
    return {
        "state": str(value.state.value),
        "is_homed": value.is_homed,
        "is_busy": value.is_busy,
    }


def _numbers(value: Numbers) -> Row:
    return {str(index): number for index, number in enumerate(value.values)}


_ROWS: Mapping[type, Callable[[Any], Row]] = MappingProxyType(
    {
        JointState: _joints,
        JointServo: _joints,
        CartesianServo: _cartesian,
        Pose: _pose,
        Poses: _poses,
        Twist: _twist,
        Wrench: _wrench,
        Status: _status,
        Numbers: _numbers,
        Number: lambda value: {"data": value.value},
        Flag: lambda value: {"data": value.value},
        Text: lambda value: {"data": value.value},
    }
)
