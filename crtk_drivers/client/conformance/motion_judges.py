"""Judges of a stream of joint positions that goes from one place to another and stays there."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import Final

import numpy as np

from crtk_drivers.client.conformance.findings import (
    Finding,
    conforms,
    diverges,
    not_offered,
    undetermined,
)
from crtk_drivers.client.conformance.observed import JointsHeard, Trace
from crtk_drivers.client.conformance.trial import far
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.samples import Array

MOST_REPEATED: Final = 10
LEAST_SAMPLES: Final = 8
RATIO: Final = 0.02
SLOPE: Final = 0.05
JACOBIAN_SHARE: Final = 0.02
NEAR: Final = 5e-3
LEAST_WAY: Final = 1e-3
"""m that the tool must have gone, or rad that it must have turned."""
ANGLE: Final = 5.0
"""Degrees."""

Numbers = Sequence[float]


def _valid(trace: Trace, name: str) -> list[JointsHeard]:
    return [each for each in trace.joints.get(name, ()) if each.stamp_ns]


def no_zeros_for_unknown(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """DAT-2."""
    heard = _valid(trace, "measured_js")
    moving = [e for e in heard if far(e.position, begin) > 0.1 * far(target, begin)]
    if not moving:
        return undetermined("it was not heard moving")
    zero = []
    for name in ("velocity", "effort"):
        vectors = [getattr(each, name) for each in heard]
        if all(vectors) and not np.any(np.concatenate(vectors)):
            zero.append(name)
    if zero:
        return diverges(f"{' and '.join(zero)} of measured_js is 0 throughout a motion, not empty")
    return conforms("what is told changes")


def fresh_stamps_are_fresh(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """DAT-12."""
    heard = _valid(trace, "measured_js")
    moving = [e for e in heard if 0.1 < far(e.position, begin) / far(target, begin) < 0.9]
    if len(moving) < LEAST_SAMPLES:
        return undetermined(f"{len(moving)} messages on the way are too few")
    longest = run = 0
    for one, after in pairwise(moving):
        same = one.position == after.position and one.stamp_ns != after.stamp_ns
        run = run + 1 if same else 0
        longest = max(longest, run)
    told = f"at most {longest} fresh stamps in a row with the same values"
    return conforms(told) if longest <= MOST_REPEATED else diverges(told)


def velocity_is_derivative(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """DAT-13."""
    heard = [e for e in _valid(trace, "measured_js") if len(e.velocity) == len(e.position) > 0]
    if not heard:
        return not_offered("no velocity is told")
    if len(heard) < 2 * LEAST_SAMPLES:
        return undetermined(f"{len(heard)} messages are too few")
    joint = int(np.argmax(np.abs(np.subtract(target, begin))))
    stamps = np.array([e.stamp_ns for e in heard], dtype=float) / 1e9
    told = np.array([e.velocity[joint] for e in heard])
    steps = np.diff(stamps)
    went = np.concatenate(([0.0], np.cumsum(0.5 * (told[1:] + told[:-1]) * steps)))
    position = np.array([e.position[joint] for e in heard])
    way = float(position[-1] - position[0])
    if abs(way) < 0.5 * abs(target[joint] - begin[joint]):
        return undetermined("it moved too little while it was heard")
    ratio = float(went[-1]) / way
    words = f"the integral of the velocity is {100 * ratio:.1f} % of the way"
    if abs(ratio - 1.0) <= SLOPE:
        return conforms(words)
    told_in = np.diff(np.unique(told))
    grain = float(np.min(told_in[told_in > 1e-9], initial=math.inf))
    if abs(ratio - 1.0) * abs(way) <= grain * float(np.sum(steps)):
        return undetermined(f"{words}, and it is told in steps of {grain:.2g}")
    if float(np.max(steps)) > 0.1:
        return undetermined(f"{words}; {float(np.max(steps)):.2f} s were not heard")
    return diverges(words)


def one_scale(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """DAT-15."""
    heard = _valid(trace, "measured_js")
    if not heard:
        return undetermined("nothing valid was measured")
    joint = int(np.argmax(np.abs(np.subtract(target, begin))))
    step = target[joint] - begin[joint]
    ratio = (heard[-1].position[joint] - begin[joint]) / step
    told = f"measured to commanded step: {ratio:.4f}"
    if abs(ratio - 1.0) <= RATIO:
        return conforms(told)
    return diverges(told) if abs(ratio - 1.0) > 2.0 * RATIO else undetermined(told)


def jacobian_gives_the_twist(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """DAT-22."""
    matrices = trace.matrices.get("jacobian", ())
    twists = {e.stamp_ns: e.numbers for e in trace.cartesian.get("measured_cv", ()) if e.stamp_ns}
    if not matrices or not twists:
        return not_offered("not both jacobian and measured_cv")
    joints = len(begin)
    pairs = [
        (each.velocity, twists[each.stamp_ns])
        for each in _valid(trace, "measured_js")
        if each.stamp_ns in twists and len(each.velocity) == joints
    ]
    if len(pairs) < LEAST_SAMPLES or matrices[-1].sizes != (6, joints):
        return undetermined("too few messages with one stamp")
    jacobian = np.reshape(matrices[-1].numbers, (6, joints))
    twist = np.array([each for _, each in pairs])
    off = np.array([velocity for velocity, _ in pairs]) @ jacobian.T - twist
    size = float(np.sqrt(np.mean(twist**2)))
    if size < 1e-6:
        return undetermined("the tool did not move")
    share = float(np.sqrt(np.mean(off**2))) / size
    told = f"{100 * share:.2f} % apart"
    return conforms(told) if share <= JACOBIAN_SHARE else diverges(told)


def twist_is_linear_first(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """DAT-18."""
    poses = [e for e in trace.cartesian.get("measured_cp", ()) if e.stamp_ns]
    twists = [e for e in trace.cartesian.get("measured_cv", ()) if e.stamp_ns]
    if not poses or not twists:
        return not_offered("not both measured_cp and measured_cv")
    if min(len(poses), len(twists)) < LEAST_SAMPLES:
        return undetermined("too few messages on the way")
    stamps = np.array([e.stamp_ns for e in twists]) / 1e9
    rates = np.array([e.numbers for e in twists])
    went = np.sum(0.5 * (rates[1:] + rates[:-1]) * np.diff(stamps)[:, None], axis=0)
    begins, ends = poses[0].numbers, poses[-1].numbers
    way, turn = np.subtract(ends[:3], begins[:3]), _turn(begins[3:], ends[3:])
    for what, done, told in (("way", way, went[:3]), ("turn", turn, went[3:])):
        length, size = float(np.linalg.norm(done)), float(np.linalg.norm(told))
        if length < LEAST_WAY:
            continue
        cosine = float(done @ told) / (length * size) if size > 0.1 * length else -1.0
        angle = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
        words = f"the {what} of the tool and that of its twist are {angle:.1f}° apart"
        return conforms(words) if angle <= ANGLE else diverges(words)
    return undetermined("the tool hardly moved")


def _turn(begin: Numbers, end: Numbers) -> Array:
    """Return the rotation vector (3,) of a small turn from one orientation to another: rad."""
    ends, begins = (matrix_from_quaternion(np.array(each)) for each in (end, begin))
    turn = ends @ begins.T
    return 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )


def twists_agree(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """SUB-1."""
    names = ("measured_cv", "body/measured_cv", "spatial/measured_cv")
    own, body, spatial = (
        {e.stamp_ns: np.array(e.numbers) for e in trace.cartesian.get(name, ()) if e.stamp_ns}
        for name in names
    )
    poses = {e.stamp_ns: e.numbers for e in trace.cartesian.get("measured_cp", ()) if e.stamp_ns}
    if not own or not poses or not (body or spatial):
        return not_offered("no twist of body or space")
    found = []
    for stamp in own.keys() & poses.keys():
        linear, angular = own[stamp][:3], own[stamp][3:]
        place, turn = np.array(poses[stamp][:3]), matrix_from_quaternion(np.array(poses[stamp][3:]))
        if stamp in body:
            expected = np.concatenate((turn.T @ linear, turn.T @ angular))
            found.append((body[stamp], expected))
        if stamp in spatial:
            found.append(
                (spatial[stamp], np.concatenate((linear - np.cross(angular, place), angular)))
            )
    if len(found) < LEAST_SAMPLES:
        return undetermined("too few messages with one stamp")
    size = float(np.sqrt(np.mean([each**2 for _, each in found])))
    if size < 1e-6:
        return undetermined("the tool did not move")
    share = float(np.sqrt(np.mean([(one - other) ** 2 for one, other in found]))) / size
    told = f"{100 * share:.2f} % apart"
    return conforms(told) if share <= JACOBIAN_SHARE else diverges(told)


def setpoint_is_told(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """SPT-1."""
    heard = _valid(trace, "setpoint_js")
    if not heard:
        return diverges("no valid setpoint_js while it streams")
    empty = [each for each in heard if not (each.position or each.velocity or each.effort)]
    told = f"{len(heard)} setpoints"
    return diverges(f"{len(empty)} of {told} are empty") if empty else conforms(told)


def setpoint_is_position(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """SPT-2."""
    heard = [each.position for each in _valid(trace, "setpoint_js") if each.position]
    if not heard:
        return undetermined("no valid position in setpoint_js")
    sent = [begin, *(each.numbers for each in trace.sent)]
    lower, upper = np.min(sent, axis=0), np.max(sent, axis=0)
    last = np.array(heard[-1])
    if np.any(last < lower - NEAR) or np.any(last > upper + NEAR):
        return diverges(f"setpoint_js {heard[-1]} is none of what was sent")
    tools = [each for each in trace.cartesian.get("setpoint_cp", ()) if each.stamp_ns]
    measured = [each for each in trace.cartesian.get("measured_cp", ()) if each.stamp_ns]
    if tools and measured:
        apart = float(np.max(np.abs(np.subtract(tools[-1].numbers[:3], measured[-1].numbers[:3]))))
        if apart > NEAR:
            return diverges(f"at rest setpoint_cp is {1e3 * apart:.1f} mm from measured_cp")
    return conforms("positions are those sent")


def setpoint_has_the_stamp(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """SPT-8."""
    sent = {each.stamp_ns for each in trace.sent if each.stamp_ns}
    first, last = trace.sent[0].at, trace.sent[-1].at
    heard = [e for e in _valid(trace, "setpoint_js") if first + 0.1 < e.at <= last]
    if len(heard) < LEAST_SAMPLES:
        return undetermined(f"{len(heard)} setpoints while it streamed are too few")
    share = sum(each.stamp_ns in sent for each in heard) / len(heard)
    told = f"{100 * share:.0f} % of the setpoints carry the stamp of a command"
    return conforms(told) if share >= 0.5 else diverges(told)


def streams_are_not_busy(trace: Trace, begin: Numbers, target: Numbers) -> Finding:
    """BSY-4."""
    if not trace.states:
        return undetermined("no operating state was heard meanwhile")
    busy = any(each.is_busy for each in trace.states)
    return diverges("busy while it streams") if busy else conforms("not busy while it streams")


Judge = Callable[[Trace, Numbers, Numbers], Finding]

JOINT_STREAM_JUDGES: Final[Mapping[str, Judge]] = MappingProxyType(
    {
        "DAT-2": no_zeros_for_unknown,
        "DAT-12": fresh_stamps_are_fresh,
        "DAT-13": velocity_is_derivative,
        "DAT-15": one_scale,
        "DAT-18": twist_is_linear_first,
        "DAT-22": jacobian_gives_the_twist,
        "SUB-1": twists_agree,
        "SPT-1": setpoint_is_told,
        "SPT-2": setpoint_is_position,
        "SPT-8": setpoint_has_the_stamp,
        "BSY-4": streams_are_not_busy,
    }
)
