"""Judges of what a device at rest publishes: sizes, names, frames, stamps, rates and kinematics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
from crtk_drivers.client.conformance.observed import (
    NUDGE,
    CartesianHeard,
    Heard,
    JointsHeard,
    Observation,
)
from crtk_drivers.commands import Payload, find

LEAST_RATE: Final = 20.0
MOST_SPREAD: Final = 3.0
MOST_LATENESS: Final = 0.25
"""Of a period: where this tool itself is later than that, it cannot judge periods."""
CLOCK_TOLERANCE: Final = 1.0
COMMON_SHARE: Final = 0.98
SELDOM: Final = 0.5
"""A share that lost messages do not explain."""
CAREFUL: Final = 0.01
"""Seconds of own lateness from which on messages may have been lost here."""
UNIT: Final = 1e-6
POSE_TOLERANCE: Final = (1e-3, 1e-2)
"""m and rad between measured pose and kinematics."""
JOINT_TOLERANCE: Final = 1e-3
JACOBIAN_TOLERANCE: Final = 1e-2
ANSWER_TIME: Final = 1.0


def place(name: str, heard: Heard) -> str:
    """Return where a message is found again: its topic and stamp."""
    return f"{name} stamped {heard.stamp_ns / 1e9:.6f}"


def numbers_of(heard: JointsHeard | CartesianHeard) -> tuple[float, ...]:
    """Return all numbers of a message."""
    if isinstance(heard, JointsHeard):
        return (*heard.position, *heard.velocity, *heard.effort)
    return heard.numbers


def pose_distance(one: Sequence[float], other: Sequence[float]) -> tuple[float, float]:
    """Return how far two poses (7,) are apart, in m and rad."""
    a, b = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    norm = float(np.linalg.norm(a[3:]) * np.linalg.norm(b[3:]))
    turn = 2.0 * math.acos(min(1.0, abs(float(a[3:] @ b[3:])) / norm)) if norm else math.pi
    return float(np.linalg.norm(a[:3] - b[:3])), turn


def _each(heard: Mapping[str, Sequence[JointsHeard]]) -> Iterator[tuple[str, JointsHeard]]:
    return ((name, message) for name, messages in heard.items() for message in messages)


def of_all(faults: Sequence[str], count: int, nothing: str) -> Finding:
    """Return what was found in `count` messages, each of which is sound or told in `faults`."""
    if faults:
        return diverges(f"{len(faults)} of {count} messages", faults)
    return conforms(f"{count} messages") if count else not_offered(nothing)


def _sizes(message: JointsHeard) -> dict[str, int]:
    vectors = {
        "name": message.name,
        "position": message.position,
        "velocity": message.velocity,
        "effort": message.effort,
    }
    return {key: len(vector) for key, vector in vectors.items() if vector}


def vector_sizes(seen: Observation) -> Finding:
    """DAT-1."""
    found = list(_each(seen.trace.joints))
    faults = [
        f"{place(name, each)}: {sizes}"
        for name, each in found
        if len(set((sizes := _sizes(each)).values())) > 1
    ]
    return of_all(faults, len(found), "no joint values")


def joint_names(seen: Observation) -> Finding:
    """DAT-3."""
    found = seen.trace.joints.get("measured_js", ())
    faults = []
    for each in found:
        if not each.name or len(set(each.name)) < len(each.name) or "" in each.name:
            faults.append(f"{place('measured_js', each)}: names {each.name}")
        elif not each.position:
            faults.append(f"{place('measured_js', each)}: no position")
    return of_all(faults, len(found), "no measured_js")


def joint_frame(seen: Observation) -> Finding:
    """DAT-4."""
    joints = seen.trace.joints.get("measured_js", ())
    if not joints:
        return not_offered("no measured_js")
    frames = {each.frame for each in joints}
    poses = {each.frame for each in seen.trace.cartesian.get("measured_cp", ())}
    if "" in frames:
        return diverges("frame_id is empty")
    if "" not in poses and poses and frames != poses:
        return diverges(f"{sorted(frames)}, and measured_cp is in {sorted(poses)}")
    return conforms(", ".join(sorted(frames)))


def cartesian_frames(seen: Observation) -> Finding:
    """DAT-5."""
    found = [(n, each) for n, heard in seen.trace.cartesian.items() for each in heard]
    found = [(n, each) for n, each in found if n in seen.trace.measured()]
    return of_all(
        [place(n, each) for n, each in found if not each.frame], len(found), "nothing Cartesian"
    )


def common_stamps(seen: Observation) -> Finding:
    """DAT-6."""
    joints = [each for each in seen.trace.joints.get("measured_js", ()) if each.stamp_ns]
    derived = [name for name in ("measured_cp", "measured_cv") if name in seen.trace.cartesian]
    if not joints or not derived:
        return not_offered("nothing that follows from joints")
    stamps = {each.stamp_ns for each in joints}
    shares = {}
    for name in derived:
        # What was heard while the other subscription was not yet there, or not any more, has no partner.
        own = [
            e.stamp_ns
            for e in seen.trace.cartesian[name]
            if min(stamps) <= e.stamp_ns <= max(stamps)
        ]
        if own:
            shares[name] = sum(each in stamps for each in own) / len(own)
    if not shares:
        return undetermined("no valid message of both was heard at one time")
    told = ", ".join(f"{name} {100 * share:.1f} %" for name, share in shares.items())
    worst = min(shares.values())
    if worst >= COMMON_SHARE:
        return conforms(told)
    if worst > SELDOM and seen.own_lateness > CAREFUL:
        return undetermined(f"{told}; this machine is {1e3 * seen.own_lateness:.0f} ms late itself")
    return diverges(f"have a stamp of measured_js: {told}")


def unit_quaternions(seen: Observation) -> Finding:
    """DAT-7."""
    found = [
        (name, each)
        for name, heard in seen.trace.cartesian.items()
        if find(name).payload is Payload.POSE
        for each in heard
        if each.stamp_ns
    ]
    faults = [
        f"{place(name, each)}: norm {norm:.9f}"
        for name, each in found
        if not abs((norm := math.hypot(*each.numbers[3:])) - 1.0) <= UNIT
    ]
    return of_all(faults, len(found), "no valid pose")


def finite_values(seen: Observation) -> Finding:
    """DAT-8."""
    found = [(n, e) for n, heard in seen.trace.stamped().items() for e in heard if e.stamp_ns]
    faults = [
        f"{place(n, e)}: {numbers_of(e)}"
        for n, e in found
        if not all(map(math.isfinite, numbers_of(e)))
    ]
    return of_all(faults, len(found), "no valid values")


def stamps_in_order(seen: Observation) -> Finding:
    """DAT-9."""
    faults, count = [], 0
    for name, heard in seen.trace.measured().items():
        valid = [each for each in heard if each.stamp_ns]
        count += len(valid)
        for one, next_one in pairwise(valid):
            if next_one.stamp_ns < one.stamp_ns:
                faults.append(f"{place(name, next_one)} after {one.stamp_ns / 1e9:.6f}")
            elif next_one.stamp_ns == one.stamp_ns and not _same(one, next_one):
                faults.append(f"{place(name, next_one)} twice, with other values")
    return of_all(faults, count, "nothing valid is measured")


def _same(one: JointsHeard | CartesianHeard, other: JointsHeard | CartesianHeard) -> bool:
    return np.array_equal(numbers_of(one), numbers_of(other), equal_nan=True)


def stamps_of_acquisition(seen: Observation) -> Finding:
    """DAT-10."""
    measured = seen.trace.measured()
    if not measured:
        return not_offered("nothing is measured")
    offsets = {
        name: [(each.stamp_ns - each.wall_ns) / 1e9 for each in heard if each.stamp_ns]
        for name, heard in measured.items()
    }
    medians = {name: float(np.median(each)) for name, each in offsets.items() if each}
    if not medians:
        return undetermined("nothing valid was measured meanwhile: all stamps are 0")
    far = {name: each for name, each in medians.items() if abs(each) > CLOCK_TOLERANCE}
    if not far:
        return conforms(f"offset {min(medians.values(), key=abs):+.4f} s")
    spread = max(medians.values()) - min(medians.values())
    even = ": the clocks of two machines?" if spread < CLOCK_TOLERANCE and len(medians) > 1 else ""
    return diverges(
        ", ".join(f"{name} is off by {each:+.1f} s" for name, each in far.items()) + even
    )


def joint_ranges(seen: Observation) -> Finding:
    """DAT-14."""
    joints = seen.manifest.get("joints")
    valid = [each for each in seen.trace.joints.get("measured_js", ()) if each.stamp_ns]
    if not valid:
        return not_offered("no valid measured_js")
    if not isinstance(joints, list) or len(joints) != len(valid[-1].position):
        return undetermined("no limits are declared that the positions could be held against")
    outside = []
    for joint, position in zip(joints, valid[-1].position, strict=True):
        lower, upper = joint.get("lower"), joint.get("upper")
        if (lower is not None and position < lower) or (upper is not None and position > upper):
            outside.append(f"{joint.get('name')} is at {position:g}, declared {lower} to {upper}")
    if outside:
        return diverges("; ".join(outside))
    return undetermined("within the declared limits; the scale itself needs an outside measurement")


def poses_on_tf(seen: Observation) -> Finding:
    """DAT-16."""
    poses = [each for each in seen.trace.cartesian.get("measured_cp", ()) if each.stamp_ns]
    if not poses:
        return not_offered("no valid measured_cp")
    own = [each for each in seen.trace.transforms if each.frame == poses[-1].frame]
    if any(_is_pose(each, poses) for each in own):
        locals_ = seen.trace.cartesian.get("local/measured_cp", ())
        others = {each.frame for each in locals_} - {poses[-1].frame}
        wrong = {each.frame for each in seen.trace.transforms} & others
        if wrong:
            return diverges(f"local/measured_cp is on /tf too, from {', '.join(sorted(wrong))}")
        return conforms(f"{poses[-1].frame} to {own[-1].child}")
    return diverges(f"no transform from {poses[-1].frame!r} on /tf is measured_cp")


def _is_pose(transform: CartesianHeard, poses: Iterable[CartesianHeard]) -> bool:
    near = POSE_TOLERANCE
    return any(
        all(d <= n for d, n in zip(pose_distance(transform.numbers, p.numbers), near, strict=True))
        for p in poses
    )


def local_place(seen: Observation) -> Finding:
    """DAT-17."""
    pairs = {
        each.stamp_ns: each for each in seen.trace.cartesian.get("measured_cp", ()) if each.stamp_ns
    }
    own = [e for e in seen.trace.cartesian.get("local/measured_cp", ()) if e.stamp_ns in pairs]
    if not own:
        return not_offered("no valid pair of local/measured_cp and measured_cp")
    apart, turned = pose_distance(own[-1].numbers, pairs[own[-1].stamp_ns].numbers)
    return conforms(f"told: they differ by {apart:.4f} m and {turned:.4f} rad")


def forward_agrees(seen: Observation) -> Finding:
    """DAT-19."""
    poses = [each for each in seen.trace.cartesian.get("measured_cp", ()) if each.stamp_ns]
    answers = seen.answers.forward
    if not answers or not poses:
        return not_offered("not both forward_kinematics and a valid measured_cp")
    if not answers[0].result:
        return diverges(f"it refuses the measured joints: {answers[0].message or 'no reason'}")
    apart, turned = pose_distance(answers[0].numbers, poses[-1].numbers)
    told = f"{1e3 * apart:.3f} mm, {1e3 * turned:.3f} mrad"
    near = apart <= POSE_TOLERANCE[0] and turned <= POSE_TOLERANCE[1]
    return conforms(told) if near else diverges(f"{told} apart")


def inverse_agrees(seen: Observation) -> Finding:
    """DAT-20."""
    if not seen.answers.inverse:
        return not_offered("no inverse_kinematics, or no valid pose to ask for")
    answer = seen.answers.inverse[0]
    if not answer.result:
        return diverges(f"it refuses the measured pose: {answer.message or 'no reason'}")
    joints = seen.answers.reference
    if len(answer.numbers) != len(joints):
        return diverges(f"{len(answer.numbers)} joints for {len(joints)}")
    off = float(np.max(np.abs(np.subtract(answer.numbers, joints)), initial=0.0))
    if off > JOINT_TOLERANCE:
        return diverges(f"{off:.4f} from the reference, which is a solution")
    for far in seen.answers.unreachable:
        if far.result:
            return diverges("a pose 1 km away has a solution")
        if not far.message and math.isfinite(far.seconds):
            return diverges("a pose out of reach is refused without a reason")
    return conforms(f"{off:.1e} from the reference; out of reach is refused")


def jacobian_is_derivative(seen: Observation) -> Finding:
    """DAT-21."""
    heard = seen.trace.matrices.get("jacobian", ())
    if not heard:
        return not_offered("no jacobian")
    matrix, answers = heard[-1], seen.answers.forward
    joints = max(
        (len(each.position) for each in seen.trace.joints.get("measured_js", ())), default=0
    )
    if matrix.sizes != (6, joints) or len(matrix.numbers) != 6 * joints:
        return diverges(f"it is {' x '.join(map(str, matrix.sizes))}, for {joints} joints")
    if len(answers) != joints + 1 or not all(each.result for each in answers):
        return undetermined("its size is right; no forward kinematics to derive")
    base = answers[0].numbers
    columns = [_rate(base, each.numbers) for each in answers[1:]]
    off = float(np.max(np.abs(np.reshape(matrix.numbers, (6, joints)) - np.transpose(columns))))
    told = f"{off:.1e} from the derivative of forward_kinematics"
    return conforms(told) if off <= JACOBIAN_TOLERANCE else diverges(told)


def _rate(base: Sequence[float], moved: Sequence[float]) -> list[float]:
    a, b = np.asarray(base[3:], dtype=float), np.asarray(moved[3:], dtype=float)
    b = b if float(a @ b) >= 0.0 else -b
    # Twice the vector part of b * conjugate(a), for small angles.
    turn = 2.0 * (a[3] * b[:3] - b[3] * a[:3] - np.cross(b[:3], a[:3]))
    linear = np.subtract(moved[:3], base[:3])
    return [*(linear / NUDGE).tolist(), *(turn / NUDGE).tolist()]


def answer_times(seen: Observation) -> Finding:
    """CLI-2."""
    answers = (*seen.answers.forward, *seen.answers.inverse, *seen.answers.unreachable)
    if not answers:
        return not_offered("no kinematics service")
    longest = max(each.seconds for each in answers)
    if longest <= ANSWER_TIME:
        return conforms(f"{len(answers)} calls, at most {1e3 * longest:.0f} ms")
    return diverges("a call got no answer" if math.isinf(longest) else f"one took {longest:.2f} s")


def feedback_rate(seen: Observation) -> Finding:
    """RAT-1."""
    rates, faults = {}, []
    for name, heard in seen.trace.measured().items():
        periods = np.diff([each.at for each in heard])
        if len(periods) < 10:
            rates[name] = len(heard) / max(seen.trace.seconds, 1e-9)
            faults.append(f"{name}: {len(heard)} messages in {seen.trace.seconds:.1f} s")
            continue
        middle, late = float(np.median(periods)), float(np.quantile(periods, 0.99))
        rates[name] = 1.0 / max(float(np.mean(periods)), 1e-9)
        if seen.own_lateness > MOST_LATENESS * middle:
            continue
        if rates[name] < LEAST_RATE:
            faults.append(f"{name}: {rates[name]:.1f} Hz")
        elif late > MOST_SPREAD * middle and late > 1.0 / LEAST_RATE:
            faults.append(f"{name}: median {1e3 * middle:.1f} ms, p99 {1e3 * late:.1f} ms")
    if not rates:
        return not_offered("nothing is measured")
    if faults:
        return diverges("; ".join(faults))
    told = ", ".join(f"{name} {rate:.0f} Hz" for name, rate in rates.items())
    if seen.own_lateness > MOST_LATENESS / max(rates.values()):
        return undetermined(f"{told}; this machine is {1e3 * seen.own_lateness:.0f} ms late itself")
    return conforms(told)


DATA_JUDGES: Final[Mapping[str, Callable[[Observation], Finding]]] = MappingProxyType(
    {
        "RAT-1": feedback_rate,
        "DAT-1": vector_sizes,
        "DAT-3": joint_names,
        "DAT-4": joint_frame,
        "DAT-5": cartesian_frames,
        "DAT-6": common_stamps,
        "DAT-7": unit_quaternions,
        "DAT-8": finite_values,
        "DAT-9": stamps_in_order,
        "DAT-10": stamps_of_acquisition,
        "DAT-14": joint_ranges,
        "DAT-16": poses_on_tf,
        "DAT-17": local_place,
        "DAT-19": forward_agrees,
        "DAT-20": inverse_agrees,
        "DAT-21": jacobian_is_derivative,
        "CLI-2": answer_times,
    }
)
