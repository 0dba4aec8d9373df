"""The judges of a stream of joint positions, on traces that were made up."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from crtk_drivers.client.conformance.findings import Verdict
from crtk_drivers.client.conformance.motion_judges import JOINT_STREAM_JUDGES
from crtk_drivers.client.conformance.observed import (
    CartesianHeard,
    JointsHeard,
    MatrixHeard,
    Sent,
    StateHeard,
    Trace,
)

BEGIN, TARGET = (0.0, 0.1), (0.0, 0.2)
COUNT, PERIOD, WAY = 100, 0.01, 0.1
ASIDE = 0.3
"""m by which the tool is beside the axis that it goes along; it turns as it goes."""


def sound() -> Trace:
    """Return a joint that goes 0.1 rad in half of the time, by a cosine, and the setpoints of that."""
    joints, setpoints, twists, poses, sent, states = [], [], [], [], [], []
    of_body, of_space = [], []
    for index in range(COUNT):
        at, stamp = PERIOD * index, 10**9 + int(1e9 * PERIOD * index)
        phase = min(1.0, 2.0 * index / COUNT)
        place = BEGIN[1] + WAY * 0.5 * (1.0 - math.cos(math.pi * phase))
        speed = WAY * math.pi * math.sin(math.pi * phase) if phase < 1.0 else 0.0
        head = (at, stamp, stamp, "base")
        joints.append(JointsHeard(*head, ("a", "b"), (0.0, place), (0.0, speed), (0.0, 1.0)))
        setpoints.append(JointsHeard(*head, ("a", "b"), (0.0, place)))
        turn = (0.0, 0.0, speed)
        half = 0.5 * place
        poses.append(
            CartesianHeard(*head, (place, ASIDE, 0.0, 0.0, 0.0, math.sin(half), math.cos(half)))
        )
        twists.append(CartesianHeard(*head, (speed, 0.0, 0.0, *turn)))
        along, across = speed * math.cos(place), -speed * math.sin(place)
        of_body.append(CartesianHeard(*head, (along, across, 0.0, *turn)))
        of_space.append(CartesianHeard(*head, (speed * (1.0 + ASIDE), -speed * place, 0.0, *turn)))
        sent.append(Sent(at, stamp, "servo_jp", (0.0, place)))
        states.append(StateHeard(*head, "ENABLED", True, False))
    jacobian = MatrixHeard(0.0, 0, 0, "", (6, 2), (0.0, 1.0, *(0.0,) * 9, 1.0))
    return Trace(
        0.0,
        COUNT * PERIOD,
        {"measured_js": tuple(joints), "setpoint_js": tuple(setpoints)},
        {
            "measured_cv": tuple(twists),
            "measured_cp": tuple(poses),
            "setpoint_cp": (poses[-1],),
            "body/measured_cv": tuple(of_body),
            "spatial/measured_cv": tuple(of_space),
        },
        {"jacobian": (jacobian,)},
        tuple(states),
        (),
        tuple(sent),
    )


def verdicts(trace: Trace) -> dict[str, Verdict]:
    return {
        each: judge(trace, BEGIN, TARGET).verdict for each, judge in JOINT_STREAM_JUDGES.items()
    }


Change = Callable[[Trace], Trace]


def joints(name: str, change: Callable[[JointsHeard], JointsHeard]) -> Change:
    return lambda t: replace(t, joints={**t.joints, name: tuple(map(change, t.joints[name]))})


def cartesian(name: str, **fields: Any) -> Change:
    return lambda t: replace(
        t,
        cartesian={**t.cartesian, name: tuple(replace(e, **fields) for e in t.cartesian[name])},
    )


def twist(name: str, change: Callable[[Any, Any], tuple[float, ...]]) -> Change:
    return lambda t: replace(
        t,
        cartesian={
            **t.cartesian,
            name: tuple(
                replace(e, numbers=change(e.numbers[:3], e.numbers[3:])) for e in t.cartesian[name]
            ),
        },
    )


def frozen(heard: JointsHeard) -> JointsHeard:
    """As a device whose values are renewed three times in a motion, under fresh stamps."""
    place = BEGIN[1] + WAY * 0.5 * (1.0 - math.cos(math.pi * min(1.0, heard.at // 0.15 * 0.3)))
    return replace(heard, position=(0.0, place))


def stretched(heard: JointsHeard) -> JointsHeard:
    return replace(heard, position=(0.0, BEGIN[1] + 1.1 * (heard.position[1] - BEGIN[1])))


CHANGES: list[tuple[str, Change]] = [
    ("DAT-2", joints("measured_js", lambda e: replace(e, effort=(0.0, 0.0)))),
    ("DAT-12", joints("measured_js", frozen)),
    (
        "DAT-13 DAT-22",
        joints("measured_js", lambda e: replace(e, velocity=(0.0, 1.2 * e.velocity[1]))),
    ),
    ("DAT-13 DAT-15", joints("measured_js", stretched)),
    (
        "DAT-22",
        lambda t: replace(
            t, matrices={"jacobian": (replace(t.matrices["jacobian"][0], numbers=(0.0,) * 12),)}
        ),
    ),
    (
        "SPT-1",
        joints("setpoint_js", lambda e: replace(e, position=() if e.at > 0.5 else e.position)),
    ),
    ("SPT-2", joints("setpoint_js", lambda e: replace(e, position=(0.0, 1.5 * e.position[1])))),
    ("SPT-2", cartesian("setpoint_cp", numbers=(0.01, ASIDE, *(0.0,) * 4, 1.0))),
    (
        "DAT-18 DAT-22 SUB-1",
        twist("measured_cv", lambda linear, angular: (*angular, *linear)),
    ),
    ("SUB-1", twist("body/measured_cv", lambda linear, angular: (linear[0], 0.0, 0.0, *angular))),
    ("SUB-1", twist("spatial/measured_cv", lambda linear, angular: (linear[0], *(0.0,) * 5))),
    ("SPT-8", joints("setpoint_js", lambda e: replace(e, stamp_ns=e.stamp_ns + 1))),
    ("BSY-4", lambda t: replace(t, states=(replace(t.states[50], is_busy=True),))),
]


def test_a_sound_motion_conforms() -> None:
    assert set(verdicts(sound()).values()) == {Verdict.CONFORMS}


@pytest.mark.parametrize(("clauses", "change"), CHANGES)
def test_one_change_diverges_from_its_clauses(clauses: str, change: Change) -> None:
    found = verdicts(change(sound()))
    assert {e for e, verdict in found.items() if verdict is Verdict.DIVERGES} == set(
        clauses.split()
    )


def test_each_judge_has_a_change_that_it_finds() -> None:
    assert {clause for each, _ in CHANGES for clause in each.split()} == set(JOINT_STREAM_JUDGES)


def test_a_velocity_in_coarse_steps_is_left_open() -> None:
    def coarse(heard: JointsHeard) -> JointsHeard:
        return replace(heard, velocity=(0.0, 0.1 * math.floor(heard.velocity[1] / 0.1)))

    found = JOINT_STREAM_JUDGES["DAT-13"](joints("measured_js", coarse)(sound()), BEGIN, TARGET)
    assert found.verdict is Verdict.UNDETERMINED
    assert "in steps of 0.1" in found.text


def test_of_a_motion_that_was_not_heard_nothing_diverges_but_the_setpoint() -> None:
    silent = replace(sound(), joints={}, cartesian={}, matrices={}, states=())
    assert {e for e, v in verdicts(silent).items() if v is Verdict.DIVERGES} == {"SPT-1"}
