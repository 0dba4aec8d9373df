"""Trials of streams: joint positions, increments, velocities and poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final

import numpy as np

from crtk_drivers.client.conformance.data_judges import pose_distance
from crtk_drivers.client.conformance.findings import (
    Finding,
    conforms,
    diverges,
    not_offered,
    undetermined,
)
from crtk_drivers.client.conformance.motion_judges import JOINT_STREAM_JUDGES
from crtk_drivers.client.conformance.observed import Trace
from crtk_drivers.client.conformance.trial import STREAM_RATE, Trial, far, ramp
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.samples import Array

VELOCITY_TIME: Final = 0.5
ANGLE: Final = math.radians(5.0)
SAME: Final = 1e-6
RELATIVE_POSES: Final = ("servo_cr", "interpolate_cr", "move_cr")
RELATIVE_TIME: Final = 0.6
"""Seconds of a stream of increments."""
BURST: Final = 4
"""Increments that are sent at once: a queue that is one deep keeps one of them."""


def positions(trial: Trial) -> None:
    """MOV-4 to MOV-6, and all that is judged of a stream of joint positions."""
    if trial.lacks(("servo_jp",), "MOV-4"):
        return
    begin, target = trial.here(), trial.away(trial.expected.step)
    if not trial.offers("setpoint_js"):
        trial.note("MOV-4", undetermined("no setpoint_js to see it by"))
        return
    heard = trial.probe.joints("measured_js")
    names = heard.name if heard is not None else ()
    began = trial.probe.now()
    trial.stream("servo_jp", ramp(begin, target), names=names)
    trial.stream("servo_jp", [target] * int(STREAM_RATE * 0.2), names=names)
    arrived = trial.arrives(target, trial.expected.stop_time)
    trial.at_rest()
    trace = trial.probe.trace(began)
    last = trace.sent[-1].numbers
    setpoints = [e for e in trace.joints.get("setpoint_js", ()) if e.position]
    ends = bool(setpoints) and far(setpoints[-1].position, last) <= SAME
    if not arrived:
        off = far(trial.here(), target)
        trial.note("MOV-4", diverges(f"it ends {off:.4f} from the newest command"))
        trial.go(begin)
        return
    trial.judge(
        "MOV-4",
        ends,
        "measured follows the newest command",
        "the setpoint is not the newest command",
    )
    trial.note("MOV-5", conforms("positions alone are followed"))
    for clause, judge in JOINT_STREAM_JUDGES.items():
        trial.note(clause, judge(trace, begin, target))
    began = trial.probe.now()
    trial.stream("servo_jp", ramp(target, begin), stamped=False)
    back = trial.arrives(begin, trial.expected.stop_time)
    told = "without names, stamp and frame"
    trial.judge("MOV-6", back, f"followed {told}", f"ignored {told}")
    trial.go(begin)


def names_in_another_order(trial: Trial) -> None:
    """MOV-7."""
    heard = trial.probe.joints("measured_js")
    if not trial.offers("servo_jp") or heard is None or len(heard.name) != len(heard.position):
        trial.note("MOV-7", not_offered("no servo_jp, or no names"))
        return
    here = list(trial.here())
    pairs = [(a, b) for a in range(len(here)) for b in range(a)]
    if not pairs:
        trial.note("MOV-7", not_offered("one joint has one order"))
        return
    one, other = min(pairs, key=lambda pair: abs(here[pair[0]] - here[pair[1]]))
    apart = abs(here[one] - here[other])
    if apart > trial.expected.stroke:
        trial.note("MOV-7", undetermined(f"no two joints are nearer than {apart:.2f}"))
        return
    begin = tuple(here)
    if apart < 0.5 * trial.expected.step:
        here[one] += trial.expected.step - (here[one] - here[other])
        trial.go(here)
    order = list(range(len(here)))
    order[one], order[other] = other, one
    before, began = trial.here(), trial.probe.now()
    # In small steps that go nowhere by name: by place they go from one to the other.
    trial.stream(
        "servo_jp",
        [tuple(before[index] for index in order)] * 10,
        names=[heard.name[index] for index in order],
    )
    trial.probe.sleep(0.3)
    moved = trial.displaced(began, before)
    trial.judge(
        "MOV-7",
        moved <= trial.still,
        "names are heeded, or refused",
        f"two joints exchanged by name: one moves by {moved:.4f}",
    )
    trial.go(begin)


def increments(trial: Trial) -> None:
    """MOV-11 and QOS-6."""
    if trial.lacks(("servo_jr", "setpoint_js"), "MOV-11", "QOS-6"):
        return
    begin = trial.here()
    way = np.subtract(trial.away(trial.expected.step), begin)
    trial.note("MOV-11", _sum(trial, way, burst=1))
    trial.go(begin)
    trial.note("QOS-6", _sum(trial, way, burst=BURST))
    trial.go(begin)


def _sum(trial: Trial, way: np.ndarray, burst: int) -> Finding:
    """Send a motion in increments, `burst` of them at once, and find their sum in the setpoint."""
    heard = trial.probe.joints("setpoint_js")
    if heard is None or not heard.position:
        return undetermined("setpoint_js has no position to add to")
    before, began = np.array(heard.position), trial.probe.now()
    rest = (0.0,) * len(way)
    points = np.array([rest, *ramp(rest, tuple(way.tolist()))])
    steps = [tuple(step / burst) for step in np.diff(points, axis=0)]
    for step in steps:
        for _ in range(burst - 1):
            trial.probe.send("servo_jr", step)
        trial.stream("servo_jr", [step])

    def share() -> float:
        newest = trial.probe.joints("setpoint_js")
        if newest is None or len(newest.position) != len(before):
            return 0.0
        return float((np.array(newest.position) - before)[trial.joint] / way[trial.joint])

    trial.probe.wait(lambda: abs(share() - 1.0) <= 0.01, trial.expected.stop_time)
    told = f"{burst * len(steps)} increments, {burst} at a time: the setpoint goes {100 * share():.1f} %"
    if abs(share() - 1.0) <= 0.01:
        return conforms(told)
    refused = trial.probe.trace(began).told
    return undetermined(f"{told}; refused: {refused[0][1][:120]}") if refused else diverges(told)


def velocities(trial: Trial) -> None:
    """MOV-12 to MOV-14, SPT-3, SPT-5 and DAT-11."""
    if trial.lacks(("servo_jv",), "MOV-12", "MOV-13", "MOV-14", "SPT-3", "SPT-5", "DAT-11"):
        return
    begin = trial.here()
    way = np.subtract(trial.away(trial.expected.step), begin)
    velocity = tuple(way / VELOCITY_TIME)
    began = trial.probe.now()
    trial.stream("servo_jv", [velocity] * int(STREAM_RATE * VELOCITY_TIME))
    ended = trial.probe.now()
    during = trial.probe.trace(began)
    trial.probe.sleep(trial.expected.stop_time)
    stands = trial.at_rest()
    silent = trial.probe.trace(ended)
    moved = (np.subtract(trial.here(), begin))[trial.joint]
    share = float(_between(during, trial.joint) / velocity[trial.joint])
    trial.note("MOV-12", _follows(share))
    if not stands:
        trial.hold()
        trial.note("MOV-13", diverges("it goes on after the stream has ended"))
        trial.note("MOV-14", undetermined("it does not stop at all"))
    else:
        time = _standstill(silent, trial) - ended
        trial.note(
            "MOV-13", conforms(f"at rest {time:.2f} s after the last, {abs(moved):.4f} in all")
        )
        trial.note("MOV-14", _stops_in_time(time, trial.stream_stop))
    trial.note("SPT-3", _velocity_setpoint(during, velocity))
    for clause in ("SPT-5", "DAT-11"):
        trial.note(clause, _invalid_pose(during))
    trial.go(begin)


def _stops_in_time(time: float, declared: float | None) -> Finding:
    if declared is None:
        return undetermined("no time is declared")
    told = f"at rest after {time:.2f} s, {declared:.2f} s are declared"
    return conforms(told) if time <= declared else diverges(told)


def _follows(share: float) -> Finding:
    told = f"{100 * share:.0f} % of the commanded velocity"
    return conforms(told) if 0.8 <= share <= 1.2 else diverges(told)


def _between(trace: Trace, joint: int) -> float:
    """Return the velocity of a joint over the second half of a trace, by positions and stamps."""
    heard = [e for e in trace.joints.get("measured_js", ()) if e.stamp_ns and e.position]
    half = [e for e in heard if e.at >= 0.5 * (trace.began + trace.ended)]
    if len(half) < 2 or half[-1].stamp_ns == half[0].stamp_ns:
        return 0.0
    way = half[-1].position[joint] - half[0].position[joint]
    return way / ((half[-1].stamp_ns - half[0].stamp_ns) / 1e9)


def _standstill(trace: Trace, trial: Trial) -> float:
    end = trial.here()
    moving = [
        e.at for e in trace.joints.get("measured_js", ()) if far(e.position, end) > trial.still
    ]
    return max(moving, default=trace.began)


def _velocity_setpoint(trace: Trace, velocity: Sequence[float]) -> Finding:
    middle = 0.5 * (trace.began + trace.ended)
    heard = [e for e in trace.joints.get("setpoint_js", ()) if e.stamp_ns and e.at > middle]
    if not heard:
        return undetermined("no valid setpoint_js meanwhile")
    without = [e for e in heard if not e.velocity]
    if without:
        return diverges(f"{len(without)} of {len(heard)} setpoints have no velocity")
    off = max(far(e.velocity, velocity) for e in heard)
    near = off <= 0.05 * max(abs(v) for v in velocity)
    told = f"velocity of the setpoint off by {off:.4f}"
    return conforms(told) if near else diverges(told)


def _invalid_pose(trace: Trace) -> Finding:
    middle = 0.5 * (trace.began + trace.ended)
    heard = [e for e in trace.cartesian.get("setpoint_cp", ()) if e.at > middle]
    if not heard:
        return not_offered("no setpoint_cp")
    valid = [e for e in heard if e.stamp_ns]
    told = f"{len(valid)} of {len(heard)} messages of setpoint_cp are stamped as valid"
    return diverges(told) if valid else conforms("stamp 0 throughout")


def poses(trial: Trial) -> None:
    """MOV-8, MOV-9 and SPT-7."""
    if trial.lacks(("servo_cp", "measured_cp"), "MOV-8", "MOV-9", "SPT-7"):
        return
    begin, joints = trial.pose(), trial.here()
    own = trial.probe.cartesian("setpoint_cp")
    same = own.numbers if own is not None and own.stamp_ns else begin
    began = trial.probe.now()
    trial.stream("servo_cp", [same] * 10)
    trial.probe.sleep(trial.expected.wait / 2.0)
    moved = trial.displaced(began, joints)
    told = f"the setpoint sent back moves a joint by {moved:.1e}"
    trial.judge("MOV-9", moved <= trial.still, told)
    if moved > trial.still:
        trial.go(joints)
        return
    changed = False
    for axis in range(3):
        before = trial.pose()
        began = trial.probe.now()
        target = list(before)
        target[axis] += trial.expected.linear_step
        trial.stream("servo_cp", ramp(before, target))
        trial.probe.sleep(0.3)
        trial.at_rest()
        trace = trial.probe.trace(began)
        trial.note("MOV-8", _direction(before, trial.pose(), axis, trial.expected.linear_step))
        setpoints = [e.position for e in trace.joints.get("setpoint_js", ()) if e.position]
        changed = changed or any(far(e, setpoints[0]) > 0.0 for e in setpoints[1:])
        trial.stream("servo_cp", ramp(trial.pose(), before))
        trial.at_rest()
    if trial.offers("setpoint_js"):
        told = "setpoint_js follows servo_cp"
        trial.judge("SPT-7", changed, told, "setpoint_js does not change")
    trial.go(joints)


def relative_poses(trial: Trial) -> None:
    """MOV-10."""
    names = [name for name in RELATIVE_POSES if trial.offers(name)]
    if not names or not trial.offers("measured_cp"):
        trial.note("MOV-10", not_offered(f"none of {', '.join(RELATIVE_POSES)}"))
        return
    joints = trial.here()
    turned = matrix_from_quaternion(np.array(trial.pose()[3:]))
    axis = int(np.argmin(np.diag(turned)))
    step = trial.expected.linear_step
    ways = {}
    for name in names:
        before = np.array(trial.pose()[:3])
        point = np.zeros(7)
        point[6] = 1.0
        if name == "move_cr":
            point[axis] = step
            trial.probe.send(name, tuple(point))
        else:
            count = int(RELATIVE_TIME * STREAM_RATE)
            point[axis] = step / count
            trial.stream(name, [tuple(point)] * count)
        trial.probe.wait(lambda b=before: _gone(trial, b) >= 0.9 * step, trial.expected.stop_time)  # type: ignore[misc]
        trial.at_rest()
        way = np.subtract(trial.pose()[:3], before)
        if np.linalg.norm(way) >= 0.5 * step:
            ways[name] = way / np.linalg.norm(way)
        trial.go(joints)
    trial.note("MOV-10", _one_frame(ways, turned, axis))


def _gone(trial: Trial, before: Sequence[float]) -> float:
    return float(np.linalg.norm(np.subtract(trial.pose()[:3], before)))


def _one_frame(ways: Mapping[str, Array], turned: Array, axis: int) -> Finding:
    """Compare the directions in which commands of one displacement went."""
    if len(ways) < 2:
        return undetermined(f"{len(ways)} of {', '.join(RELATIVE_POSES)} moved the tool")
    frames = {"the base": np.eye(3)[axis], "the tool": turned[:, axis]}
    said = []
    for name, way in ways.items():
        near = [frame for frame, direction in frames.items() if way @ direction >= math.cos(ANGLE)]
        said.append(f"{name} along {'xyz'[axis]} of {' and '.join(near) or 'neither'}")
    apart = max(
        math.acos(max(-1.0, min(1.0, float(a @ b)))) for a, b in combinations(ways.values(), 2)
    )
    told = "; ".join(said)
    return conforms(told) if apart <= 2.0 * ANGLE else diverges(told)


def _direction(before: Sequence[float], after: Sequence[float], axis: int, step: float) -> Finding:
    way = np.subtract(after[:3], before[:3])
    length = float(np.linalg.norm(way))
    if length < 0.2 * step:
        return undetermined(
            f"it moved by {1e3 * length:.2f} mm along {'xyz'[axis]}: refused, or out of room"
        )
    angle = math.acos(max(-1.0, min(1.0, float(way[axis]) / length)))
    _, turned = pose_distance(before, after)
    told = f"along {'xyz'[axis]}: {math.degrees(angle):.1f}° off"
    straight = angle <= ANGLE and turned <= ANGLE
    return conforms(told) if straight else diverges(f"{told}, turned by {turned:.3f} rad")
