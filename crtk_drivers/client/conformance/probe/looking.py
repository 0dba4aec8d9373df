"""A device is listened to, and asked what services answer at rest. Nothing is commanded."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from crtk_drivers.client.conformance.data_judges import ANSWER_TIME
from crtk_drivers.client.conformance.observed import (
    NUDGE,
    STATE_SERVICE,
    Answer,
    Answers,
    Graph,
    Observation,
    StateHeard,
)
from crtk_drivers.client.conformance.probe.ears import Ears
from crtk_drivers.client.conformance.probe.heard_messages import Raw, state_heard
from crtk_drivers.client.conformance.state_judges import SILENCE
from crtk_drivers.client.ros_link import Caller, Link
from crtk_drivers.commands import ROS_TYPES, Payload
from crtk_drivers.errors import ConnectionFailed, DataTimeout
from crtk_drivers.ros.messages import TYPES, set_pose
from crtk_drivers.samples import Pose, vector

STATE_CALLS = 10
FAR = 1000.0
"""m: no arm reaches that."""
LONGEST_CALL = 5.0 * ANSWER_TIME
"""Seconds after which there is no answer."""
_TICK = 0.01


def look(
    link: Link, ears: Ears, graph: Graph, manifest: Mapping[str, Any], seconds: float
) -> Observation:
    """Listen for `seconds`, and longer while no heartbeat was heard; then ask the services."""
    began = time.monotonic()
    late = []
    while (now := time.monotonic()) < began + seconds or (
        ears.count("operating_state") < 2 and now < began + SILENCE
    ):
        time.sleep(_TICK)
        late.append(time.monotonic() - now - _TICK)
    trace = ears.trace(began)
    answers = _ask(link, ears, graph)
    return Observation(graph, trace, answers, manifest, float(np.quantile(late, 0.99)))


def _ask(link: Link, ears: Ears, graph: Graph) -> Answers:
    prefix = f"{graph.namespace.rstrip('/')}/"

    def caller(name: str, ros_type: str, kind: Payload | None) -> Caller | None:
        if graph.services.get(name) != (ros_type,):
            return None
        topic = f"{prefix}{name}"
        return link.state_caller(topic) if kind is None else link.caller(topic, TYPES[kind])

    state = caller("operating_state", STATE_SERVICE, None)
    forward, inverse = (
        caller(kind.name.lower(), ROS_TYPES[kind], kind)
        for kind in (Payload.FORWARD_KINEMATICS, Payload.INVERSE_KINEMATICS)
    )
    joints, pose = ears.joints("measured_js"), ears.cartesian("measured_cp")
    here = joints.position if joints is not None and joints.stamp_ns else ()
    at = pose.numbers if pose is not None and pose.stamp_ns and here else ()
    far = (at[0] + FAR, *at[1:]) if at else ()
    return Answers(
        _states(state, ears) if state is not None else (),
        tuple(_forward(forward, each) for each in _nudged(here)) if forward and here else (),
        (_inverse(inverse, at, here),) if inverse and at else (),
        (_inverse(inverse, far, here),) if inverse and at else (),
        here,
    )


def _states(
    service: Caller, ears: Ears
) -> tuple[tuple[StateHeard | None, StateHeard, StateHeard | None], ...]:
    found = []
    for _ in range(STATE_CALLS):
        before = ears.state()
        try:
            answer = service.call(LONGEST_CALL).operating_state
        except (ConnectionFailed, DataTimeout):
            break
        told = state_heard(Raw(time.monotonic(), time.time_ns(), answer))
        found.append((before, told))
    heard = ears.count("operating_state")
    ears.wait(lambda: ears.count("operating_state") > heard, ANSWER_TIME)
    after = ears.state()
    return tuple((before, told, after) for before, told in found)


def _nudged(here: Sequence[float]) -> list[tuple[float, ...]]:
    postures = [tuple(here)]
    for index in range(len(here)):
        moved = list(here)
        moved[index] += NUDGE
        postures.append(tuple(moved))
    return postures


def _forward(service: Caller, joints: Sequence[float]) -> Answer:
    began = time.monotonic()
    try:
        answer = service.call(LONGEST_CALL, jp=list(joints))
    except (ConnectionFailed, DataTimeout):
        return Answer(math.inf, asked=tuple(joints))
    p, q = answer.cp.position, answer.cp.orientation
    numbers = (p.x, p.y, p.z, q.x, q.y, q.z, q.w)
    seconds = time.monotonic() - began
    return Answer(seconds, bool(answer.result), str(answer.message), numbers, tuple(joints))


def _inverse(service: Caller, pose: Sequence[float], reference: Sequence[float]) -> Answer:
    wanted = TYPES[Payload.POSE]().pose
    set_pose(wanted, Pose(vector(pose[:3]), vector(pose[3:])))
    began = time.monotonic()
    try:
        answer = service.call(LONGEST_CALL, cp=wanted, jp=list(reference))
    except (ConnectionFailed, DataTimeout):
        return Answer(math.inf, asked=tuple(pose))
    seconds = time.monotonic() - began
    return Answer(seconds, bool(answer.result), str(answer.message), tuple(answer.jp), tuple(pose))
