"""The form of a method: its parameters, what it returns, and its docstring, from the command table.

`help(arm.move_jp)` and the types that a type checker sees (`python -m crtk_drivers.cli.type_stubs`) are
made of it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from inspect import Parameter, Signature
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from crtk_drivers.commands import Command, Direction, Kind, Level, Payload, Space

DEFAULT_AGE = 0.1
"""Seconds that feedback may be old unless `age` says otherwise."""

DEFAULT_WAIT = 1.0
"""Seconds to wait for fresh feedback unless `wait` says otherwise."""

QUERY_TIMEOUT = 5.0
"""Seconds in which a kinematics service must answer, unless `timeout` says otherwise."""

SERVICE_TIMEOUT = 30.0
"""Seconds to wait for a device's own service, unless `timeout` says otherwise."""

WIDTH = 92
"""Of the lines of a docstring."""


@dataclass(frozen=True, slots=True)
class Form:
    """What a method looks like to those who call it.

    Attributes:
        signature: without `self`; the types are text, see `crtk_drivers.front.kinds`.
        doc: the docstring.
        is_feedback: with ``extra=True`` it returns the stamp as well.
    """

    signature: Signature
    doc: str
    is_feedback: bool = False


Method = TypeVar("Method", bound=Callable[..., Any])


def documented(method: Method, form: Form) -> Method:
    """Return `method`, for which `help` and editors show `form`."""
    method.__doc__ = form.doc
    vars(method)["__signature__"] = form.signature
    return method


def first_line(doc: str) -> str:
    """Return the first line of a docstring."""
    return doc.partition("\n")[0]


class _Words(NamedTuple):
    """How a value is described: its name, shape and units, its type as an argument and as a result."""

    name: str
    shape: str
    accepted: str
    returned: str


_VALUES: Mapping[tuple[Payload, Kind], _Words] = MappingProxyType(
    {
        key: _Words(*words)
        for key, words in {
            (Payload.JOINT_STATE, Kind.POSITION): (
                "joint positions", "(n,) in rad (m), one for each joint", "JointsLike", "Vector"),
            (Payload.JOINT_STATE, Kind.RELATIVE): (
                "increments of the joint positions", "(n,) in rad (m), one for each joint",
                "JointsLike", "Vector"),
            (Payload.JOINT_STATE, Kind.VELOCITY): (
                "joint velocities", "(n,) in rad/s (m/s), one for each joint", "JointsLike", "Vector"),
            (Payload.JOINT_STATE, Kind.EFFORT): (
                "joint efforts", "(n,) in N·m (N), one for each joint", "JointsLike", "Vector"),
            (Payload.JOINT_STATE, Kind.STATE): (
                "joint state",
                "position (n,) in rad (m), velocity (n,) in rad/s (m/s), effort (n,) in N·m (N)",
                "JointState", "JointState"),
            (Payload.POSE, Kind.POSITION): (
                "pose of the tool", "position (3,) in m, orientation (4,) a unit quaternion x, y, z, w",
                "PoseLike", "Pose"),
            (Payload.POSE, Kind.RELATIVE): (
                "increments of the tool's pose",
                "position (3,) in m, orientation (4,) a unit quaternion x, y, z, w", "PoseLike", "Pose"),
            (Payload.TWIST, Kind.VELOCITY): (
                "velocity of the tool", "linear (3,) in m/s, angular (3,) in rad/s", "TwistLike", "Twist"),
            (Payload.WRENCH, Kind.EFFORT): (
                "force and torque at the tool", "force (3,) in N, torque (3,) in N·m",
                "WrenchLike", "Wrench"),
            (Payload.JOINT_SERVO, Kind.STATE): (
                "joint setpoints of a kind for each joint",
                "for each joint a position in rad (m), a velocity in rad/s (m/s) or an effort in N·m (N)",
                "JointServo", "JointServo"),
            (Payload.CARTESIAN_SERVO, Kind.STATE): (
                "setpoints of the tool of a kind for each axis",
                "for each axis of a task frame a pose in m (rad), a velocity in m/s (rad/s) "
                "or a force in N (N·m)",
                "CartesianServo", "CartesianServo"),
            (Payload.POSES, Kind.NONE): (
                "poses", "for each, position (3,) in m, orientation (4,) a unit quaternion x, y, z, w",
                "Poses", "Poses"),
            (Payload.MATRIX, Kind.NONE): ("matrix", "(6, n) in m/rad and 1", "Matrix", "Matrix"),
            (Payload.NUMBER, Kind.NONE): ("number", "a number", "float", "float"),
            (Payload.NUMBERS, Kind.NONE): ("numbers", "numbers", "ArrayLike", "tuple[float, ...]"),
            (Payload.FLAG, Kind.NONE): ("switch", "True or False", "bool", "bool"),
            (Payload.TEXT, Kind.NONE): ("text", "a text", "str", "str"),
            (Payload.JOY, Kind.NONE): (
                "axes and buttons", "axes from -1 to 1, buttons 1 (pressed) or 0", "Joy", "Joy"),
        }.items()
    }
)  # fmt: skip

_KIND_OF_PAYLOAD: Mapping[Payload, Kind] = MappingProxyType(
    {
        Payload.POSE: Kind.POSITION,
        Payload.TWIST: Kind.VELOCITY,
        Payload.WRENCH: Kind.EFFORT,
        Payload.JOINT_SERVO: Kind.STATE,
        Payload.CARTESIAN_SERVO: Kind.STATE,
    }
)
"""The kind of a payload where a device's own input or reading does not say it."""

# The first line, by level; `{}` is what the value is called.
_DOES: Mapping[Level, str] = MappingProxyType(
    {
        Level.MEASURED: "Return the measured {}.",
        Level.SETPOINT: "Return what was last sent to the low-level control: {}.",
        Level.GOAL: "Return the goal last accepted by interpolate or move: {}.",
        Level.SERVO: "Stream in real time, the newest wins: {}.",
        Level.INTERPOLATE: "Stream at a low rate, smoothed by the device: {}.",
        Level.MOVE: "Plan a trajectory to a goal and stop there: {}.",
    }
)

_POSE_IN_FRAME: Mapping[str, str] = MappingProxyType(
    {"": "In the base frame.", "local": "In the frame of the device's own base."}
)

_ALONG_AXES: Mapping[str, str] = MappingProxyType(
    {
        "": "Along the axes of the base frame, at the tool point.",
        "local": "Along the axes of the device's own base, at the tool point.",
        "body": "Along the axes of the tool, at the tool point.",
        "spatial": "Along the axes of the base frame, at its origin.",
        "raw": "As the sensor measures, without bias and filters.",
    }
)

_FEEDBACK_ARGS = (
    ("age", f"how old the value may be, in s; 0 takes any. None: {DEFAULT_AGE:g} s."),
    ("wait", f"how long to wait for one that is new enough, in s. None: {DEFAULT_WAIT:g} s."),
    ("extra", "also return the stamp, in s since the epoch; 0 marks a value that is not valid."),
)
_FIRST_USE = "over ROS at the first use, the other end was not found in time"
_NO_DATA = (
    "DataTimeout: there is no value that is new enough.",
    f"ConnectionFailed: {_FIRST_USE}; CrtkError inside a callback.",
)
_REFUSED = "CommandRefused: the device does not accept it; the error says why, and what to do."
_REFUSED_LATE = f"{_REFUSED} Over ROS the next call raises it."
_SENT = (
    "ConnectionLost: over ROS, nobody listens to it any more.",
    f"ConnectionFailed, DataTimeout: {_FIRST_USE}; CrtkError inside a callback.",
)
_ASKED = (
    "ConnectionFailed, DataTimeout: over ROS, nobody serves it, or there was no answer in `timeout` s; "
    "CrtkError inside a callback."
)
_SERVED = (
    "CommandRefused: it cannot be carried out now; the error says why.",
    "DataTimeout: it has not ended in `timeout` s; it goes on all the same.",
    "TransitionFailed: a stop broke it off, or it did not end in the time that the device has for it.",
    "ConnectionLost: the link to the device was lost meanwhile.",
    "CrtkError: what the device says of why it failed.",
)


@cache
def form_of(command: Command, field: str = "") -> Form:
    """Return the form of the method of a command; with `field`, of that part of a joint state."""
    if command.direction is Direction.PUBLISHED:
        return _feedback(command, field)
    if command.direction is Direction.SERVICE:
        return _query(command)
    if command.payload is Payload.EMPTY:
        return _form(summary_of(command), (), "None", raises=(_REFUSED, *_SENT))
    words = _VALUES[command.payload, command.kind]
    name = "goal" if command.level is Level.MOVE else "value"
    returns, result = "None", ""
    if command.level is Level.MOVE:
        returns = "Move"
        result = (
            "Move: `wait()` waits until it has ended. It raises MotionAborted where that is not at the "
            "goal, and over ROS ConnectionLost once the device is not heard any more."
        )
    return _form(
        summary_of(command),
        (_parameter(name, words.accepted),),
        returns,
        args=((name, f"{_accepted(words)} {_frame(command)}".strip()),),
        result=result,
        raises=(_REFUSED_LATE if command.is_stream else _REFUSED, *_SENT),
    )


_ALSO: Mapping[str, str] = MappingProxyType(
    {
        "JointsLike": "; or a JointState",
        "PoseLike": "; as a Pose, these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3",
        "TwistLike": "; as a Twist or these 6 numbers",
        "WrenchLike": "; as a Wrench or these 6 numbers",
        "JointServo": "; as a JointServo",
        "CartesianServo": "; as a CartesianServo",
    }
)


@cache
def form_of_service(summary: str) -> Form:
    """Return the form of what a device does beyond CRTK."""
    timeout = Parameter(
        "timeout", Parameter.POSITIONAL_OR_KEYWORD, default=SERVICE_TIMEOUT, annotation="float"
    )
    return _form(
        _sentence(summary),
        (timeout,),
        "str",
        args=(("timeout", "how long to wait for the answer, in s."),),
        result="str: the answer of the device, in words.",
        raises=_SERVED,
    )


@cache
def form_of_input(summary: str, payload: Payload) -> Form:
    """Return the form of what a device takes beyond CRTK."""
    words = _value(payload, Kind.POSITION)
    return _form(
        _sentence(summary),
        (_parameter("value", words.accepted),),
        "None",
        args=(("value", _accepted(words)),),
        raises=(_REFUSED,),
    )


@cache
def form_of_reading(summary: str, payload: Payload) -> Form:
    """Return the form of what a device tells beyond CRTK."""
    words = _value(payload, Kind.STATE)
    return _form(
        _sentence(summary),
        (),
        words.returned,
        result=f"{words.returned}: {words.shape}.",
        raises=("DataTimeout: it is not known now.",),
    )


def _feedback(command: Command, field: str) -> Form:
    kind = _KIND_OF_FIELD[field] if field else command.kind
    words = _VALUES[command.payload, kind]
    keyword = Parameter.POSITIONAL_OR_KEYWORD
    parameters = (
        Parameter("age", keyword, default=None, annotation="float | None"),
        Parameter("wait", keyword, default=None, annotation="float | None"),
        Parameter("extra", keyword, default=False, annotation="bool"),
    )
    form = _form(
        summary_of(command, kind),
        parameters,
        words.returned,
        args=_FEEDBACK_ARGS,
        result=f"{words.returned}: {words.shape}. {_frame(command)}".strip(),
        raises=_NO_DATA,
    )
    return Form(form.signature, form.doc, is_feedback=True)


_KIND_OF_FIELD = MappingProxyType(
    {"position": Kind.POSITION, "velocity": Kind.VELOCITY, "effort": Kind.EFFORT}
)


def _query(command: Command) -> Form:
    keyword = Parameter.POSITIONAL_OR_KEYWORD
    timeout = Parameter("timeout", keyword, default=QUERY_TIMEOUT, annotation="float")
    until = ("timeout", "how long to wait for the answer, in s.")
    refused = (
        "CommandRefused: what was given cannot be used; a wrong size or a value that is not finite "
        "is a KinematicsError over ROS."
    )
    joints = "(n,) in rad (m), one for each joint"
    pose = "position (3,) in m, orientation (4,) a unit quaternion x, y, z, w"
    if command.payload is Payload.FORWARD_KINEMATICS:
        given = Parameter("joints", keyword, annotation="ArrayLike")
        return _form(
            summary_of(command),
            (given, timeout),
            "Pose",
            args=(("joints", f"{joints}."), until),
            result=f"Pose: {pose}. {_frame(command)}",
            raises=(refused, _ASKED),
        )
    given = Parameter("pose", keyword, annotation="PoseLike")
    reference = Parameter("reference", keyword, default=(), annotation="ArrayLike")
    return _form(
        summary_of(command),
        (given, reference, timeout),
        "Vector",
        args=(
            ("pose", f"{pose}{_ALSO['PoseLike']}. {_frame(command)}"),
            ("reference", f"{joints}: the solution nearest to it is returned; empty: to the arm."),
            until,
        ),
        result=f"Vector: {joints}.",
        raises=(
            refused,
            "KinematicsError: no joint position within the limits reaches the pose.",
            _ASKED,
        ),
    )


def summary_of(command: Command, kind: Kind | None = None) -> str:
    """Return the first line of the docstring of a command; with `kind`, of that part of a joint state."""
    does = _DOES.get(command.level)
    if does is None or command.space is Space.NONE:
        return _sentence(command.summary)
    return does.format(_VALUES[command.payload, kind or command.kind].name)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def _frame(command: Command) -> str:
    space = command.name.rpartition("/")[0]
    if not space and command.level is Level.MEASURED and command.space is Space.CARTESIAN:
        return "`frame_id` says in which frame: of an arm the base frame, at the tool point."
    if command.kind is Kind.POSITION or command.direction is Direction.SERVICE:
        is_placed = command.space is Space.CARTESIAN or command.level is Level.QUERY
        return _POSE_IN_FRAME.get(space, "") if is_placed else ""
    if command.payload in (Payload.POSE, Payload.TWIST, Payload.WRENCH, Payload.MATRIX):
        return _ALONG_AXES.get(space, "")
    return ""


def _accepted(words: _Words) -> str:
    return f"{words.shape}{_ALSO.get(words.accepted, '')}."


def _value(payload: Payload, joints: Kind) -> _Words:
    """Return the words for a value of a device's own; `joints` is what counts of a joint state."""
    kind = joints if payload is Payload.JOINT_STATE else _KIND_OF_PAYLOAD.get(payload, Kind.NONE)
    return _VALUES.get((payload, kind), _Words(payload, f"a {payload}", "Any", "Any"))


def _parameter(name: str, annotation: str) -> Parameter:
    return Parameter(name, Parameter.POSITIONAL_ONLY, annotation=annotation)


def _form(
    summary: str,
    parameters: tuple[Parameter, ...],
    returns: str,
    *,
    args: tuple[tuple[str, str], ...] = (),
    result: str = "",
    raises: tuple[str, ...] = (),
) -> Form:
    sections = (
        ("Args", [f"{name}: {text}" for name, text in args]),
        ("Returns", [result] if result else []),
        ("Raises", [*raises]),
    )
    lines = textwrap.wrap(summary, WIDTH)
    for title, entries in sections:
        if entries:
            lines += ["", f"{title}:"]
            for entry in entries:
                lines += _entry(entry)
    return Form(Signature(list(parameters), return_annotation=returns), "\n".join(lines))


@cache
def _entry(text: str) -> tuple[str, ...]:
    return tuple(textwrap.wrap(text, WIDTH, initial_indent="    ", subsequent_indent="        "))
