"""The judges of a device at rest, on observations that were made up: one change, one clause."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import pytest

from crtk_drivers.client.conformance.findings import Verdict
from crtk_drivers.client.conformance.observed import (
    NUDGE,
    Answer,
    Answers,
    CartesianHeard,
    Endpoint,
    Graph,
    Heard,
    JointsHeard,
    MatrixHeard,
    Observation,
    StateHeard,
    Trace,
)
from crtk_drivers.client.conformance.rounds import JUDGES
from crtk_drivers.commands import Direction

JOINTS = ("a", "b", "c")
PLACE = (0.1, 0.2, 0.3)
POSE = (*PLACE, 0.0, 0.0, 0.0, 1.0)
COUNT = 100
PERIOD = 0.02
WALL = 1_700_000_000 * 10**9

OFFERED = (
    ("measured_js", "sensor_msgs/msg/JointState"),
    ("setpoint_js", "sensor_msgs/msg/JointState"),
    ("measured_cp", "geometry_msgs/msg/PoseStamped"),
    ("setpoint_cp", "geometry_msgs/msg/PoseStamped"),
    ("measured_cv", "geometry_msgs/msg/TwistStamped"),
    ("local/measured_cp", "geometry_msgs/msg/PoseStamped"),
    ("jacobian", "std_msgs/msg/Float64MultiArray"),
    ("goal_js", "sensor_msgs/msg/JointState"),
    ("operating_state", "crtk_msgs/msg/OperatingState"),
)
TAKEN = (
    ("servo_jp", "sensor_msgs/msg/JointState"),
    ("move_jp", "sensor_msgs/msg/JointState"),
    ("state_command", "crtk_msgs/msg/StringStamped"),
)
SERVICES = {
    "operating_state": ("crtk_msgs/srv/TriggerOperatingState",),
    "forward_kinematics": ("crtk_msgs/srv/QueryForwardKinematics",),
    "inverse_kinematics": ("crtk_msgs/srv/QueryInverseKinematics",),
}
HASHES = {"crtk_msgs/msg/OperatingState": "RIHS01_1a", "crtk_msgs/msg/StringStamped": "RIHS01_2b"}
MANIFEST: Mapping[str, Any] = {
    "commands": {
        **{name: {"direction": "published"} for name, _ in OFFERED},
        **{name: {"direction": "commanded"} for name, _ in TAKEN},
    },
    "joints": [{"name": name, "lower": -1.0, "upper": 1.0} for name in JOINTS],
    "homing": False,
}


def times(index: int) -> tuple[float, int, int]:
    at = PERIOD * index
    return at, WALL + int(1e9 * at), WALL + int(1e9 * at) - 10**6


def endpoint(name: str, ros_type: str, direction: Direction) -> Endpoint:
    latched = name in ("goal_js", "operating_state")
    return Endpoint(name, direction, ros_type, HASHES.get(ros_type, "RIHS01_3c"), latched=latched)


def sound() -> Observation:
    """Return a device that is as it should be."""
    graph = Graph(
        "/arm",
        (
            *(endpoint(name, kind, Direction.PUBLISHED) for name, kind in OFFERED),
            *(endpoint(name, kind, Direction.COMMANDED) for name, kind in TAKEN),
        ),
        SERVICES,
        HASHES,
    )
    rows = range(COUNT)
    joints = tuple(JointsHeard(*times(i), "base", JOINTS, PLACE, (0.0,) * 3) for i in rows)
    poses = tuple(CartesianHeard(*times(i), "base", POSE) for i in rows)
    twists = tuple(CartesianHeard(*times(i), "base", (0.0,) * 6) for i in rows)
    states = tuple(
        StateHeard(*times(i), "", "DISABLED", is_homed=True) for i in range(0, COUNT, 10)
    )
    identity = tuple(float(row == column) for row in range(6) for column in range(3))
    trace = Trace(
        0.0,
        COUNT * PERIOD,
        {"measured_js": joints, "setpoint_js": joints},
        {
            "measured_cp": poses,
            "setpoint_cp": poses,
            "measured_cv": twists,
            "local/measured_cp": poses,
        },
        {"jacobian": (MatrixHeard(*times(0), "", (6, 3), identity),)},
        states,
        (replace(poses[50], child="tool"),),
    )
    moved = [tuple(p + NUDGE * (i == j) for j, p in enumerate(PLACE)) for i in range(3)]
    answers = Answers(
        tuple((states[-1], states[-1], states[-1]) for _ in range(3)),
        tuple(Answer(0.01, True, "", (*p, 0.0, 0.0, 0.0, 1.0)) for p in (PLACE, *moved)),
        (Answer(0.01, True, "", PLACE),),
        (Answer(0.01, False, "out of reach"),),
        PLACE,
    )
    return Observation(graph, trace, answers, MANIFEST, 0.001)


Change = Callable[[Observation], Observation]


def graph(change: Callable[[Graph], Graph]) -> Change:
    return lambda seen: replace(seen, graph=change(seen.graph))


def trace(change: Callable[[Trace], Trace]) -> Change:
    return lambda seen: replace(seen, trace=change(seen.trace))


def answers(**fields: Any) -> Change:
    return lambda seen: replace(seen, answers=replace(seen.answers, **fields))


def each_endpoint(name: str, **fields: Any) -> Change:
    """Change the endpoint of a name."""
    return graph(
        lambda g: replace(
            g,
            endpoints=tuple(
                replace(each, **fields) if each.name == name else each for each in g.endpoints
            ),
        )
    )


def another(name: str, ros_type: str, direction: Direction = Direction.PUBLISHED) -> Change:
    """Add an endpoint, also to what the manifest tells."""

    def change(seen: Observation) -> Observation:
        added = (*seen.graph.endpoints, endpoint(name, ros_type, direction))
        return replace(seen, graph=replace(seen.graph, endpoints=added), manifest={})

    return change


def without(*names: str) -> Change:
    def change(seen: Observation) -> Observation:
        left = tuple(each for each in seen.graph.endpoints if each.name not in names)
        return replace(seen, graph=replace(seen.graph, endpoints=left), manifest={})

    return change


def joints(name: str, change: Callable[[JointsHeard], JointsHeard], every: int = 1) -> Change:
    """Change every n-th message of joint values."""

    def on(t: Trace) -> Trace:
        heard = tuple(change(e) if i % every == 0 else e for i, e in enumerate(t.joints[name]))
        return replace(t, joints={**t.joints, name: heard})

    return trace(on)


def tool(name: str, change: Callable[[CartesianHeard], CartesianHeard]) -> Change:
    def on(t: Trace) -> Trace:
        return replace(t, cartesian={**t.cartesian, name: tuple(map(change, t.cartesian[name]))})

    return trace(on)


def states(change: Callable[[StateHeard], StateHeard]) -> Change:
    return trace(lambda t: replace(t, states=tuple(map(change, t.states))))


def later(heard: Heard, seconds: float) -> int:
    return heard.stamp_ns + int(1e9 * seconds)


POSE_TYPE, JOINT_TYPE = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/JointState"
SERVICE_LIES = tuple((s, replace(s, state="PAUSED"), s) for s in sound().trace.states[:3])

CHANGES: list[tuple[str, Change]] = [
    ("NAM-1", another("measured_jq", JOINT_TYPE)),
    ("NAM-2", graph(lambda g: replace(g, namespace="/my arm"))),
    ("NAM-3", another("body/measured_js", JOINT_TYPE)),
    ("TYP-1", each_endpoint("measured_cp", ros_type="geometry_msgs/msg/TransformStamped")),
    ("TYP-2", each_endpoint("state_command", ros_type="std_msgs/msg/String")),
    ("TYP-2", each_endpoint("operating_state", type_hash="RIHS01_9f")),
    ("TYP-3", graph(lambda g: replace(g, services={"forward_kinematics": ("std_srvs/srv/Trigger",)}))),
    ("SET-2", without("state_command")),
    ("SET-3", without("setpoint_js")),
    ("SET-4", without("goal_js")),
    ("QOS-1", each_endpoint("measured_js", reliable=False)),
    ("QOS-2", each_endpoint("state_command", latched=True)),
    ("QOS-3", trace(lambda t: replace(t, states=(), ended=10.0))),
    ("QOS-4", each_endpoint("goal_js", latched=False)),
    ("QOS-7", another("measured_cv", "geometry_msgs/msg/TwistStamped")),
    ("RAT-1", joints("measured_js", lambda e: replace(e, at=10.0 * e.at))),
    ("DAT-1", joints("measured_js", lambda e: replace(e, velocity=(0.0, 0.0)), every=50)),
    ("DAT-3", joints("measured_js", lambda e: replace(e, position=()), every=50)),
    ("DAT-4", joints("measured_js", lambda e: replace(e, frame=""))),
    ("DAT-4", joints("measured_js", lambda e: replace(e, frame="world"))),
    ("DAT-5", tool("measured_cv", lambda e: replace(e, frame=""))),
    ("DAT-6", tool("measured_cv", lambda e: replace(e, stamp_ns=e.stamp_ns + 1))),
    ("DAT-7", tool("measured_cp", lambda e: replace(e, numbers=(*PLACE, 0.0, 0.0, 0.0, 1.00001)))),
    ("DAT-8", joints("measured_js", lambda e: replace(e, velocity=(math.nan,) * 3))),
    ("DAT-9", joints("measured_js", lambda e: replace(e, stamp_ns=later(e, 0.2)), every=50)),
    ("DAT-10", joints("measured_js", lambda e: replace(e, wall_ns=e.wall_ns - 2 * 10**9))),
    ("DAT-14", lambda s: replace(s, manifest={**MANIFEST, "joints": [
        {"name": name, "lower": -1.0, "upper": 0.25} for name in JOINTS]})),
    ("DAT-16", trace(lambda t: replace(t, transforms=()))),
    ("DAT-19", tool("measured_cp", lambda e: replace(e, numbers=(0.11, *POSE[1:])))),
    ("DAT-20", answers(inverse=(Answer(0.01, True, "", (0.1, 0.2, 0.4)),))),
    ("DAT-20", answers(unreachable=(Answer(0.01, True, "", PLACE),))),
    ("DAT-20", answers(unreachable=(Answer(0.01),))),
    ("DAT-21", trace(lambda t: replace(t, matrices={"jacobian": (
        MatrixHeard(*times(0), "", (3, 6), (0.0,) * 18),)}))),
    ("STA-1", states(lambda e: replace(e, state="Disabled"))),
    ("STA-2", states(lambda e: replace(e, stamp_ns=WALL))),
    ("STA-3", states(lambda e: replace(e, at=10.0 * e.at))),
    ("STA-4", answers(states=SERVICE_LIES)),
    ("HOM-1", states(lambda e: replace(e, is_homed=False))),
    ("BSY-1", states(lambda e: replace(e, is_busy=True))),
    ("CLI-2", answers(inverse=(Answer(1.5, True, "", PLACE),))),
    ("MAN-1", lambda s: replace(s, manifest={"commands": {"move_cp": {"direction": "commanded"}}})),
]  # fmt: skip

ALSO = {"DAT-19": {"DAT-16"}}
"""What one change breaks too: a pose elsewhere is not on /tf either."""


def diverging(seen: Observation) -> set[str]:
    return {each for each, judge in JUDGES.items() if judge(seen).verdict is Verdict.DIVERGES}


def test_a_sound_device_diverges_nowhere() -> None:
    verdicts = {each: judge(sound()).verdict for each, judge in JUDGES.items()}
    open_ones = {each for each, verdict in verdicts.items() if verdict is not Verdict.CONFORMS}
    assert open_ones == {"NAM-4", "DAT-14"}, "no gripper; the absolute scale is never known"


@pytest.mark.parametrize(("clause", "change"), CHANGES)
def test_one_change_diverges_from_one_clause(clause: str, change: Change) -> None:
    assert diverging(change(sound())) - ALSO.get(clause, set()) == {clause}


def test_each_judge_has_a_change_that_it_finds() -> None:
    told_only = {"NAM-4", "DAT-17"}
    assert set(JUDGES) - {clause for clause, _ in CHANGES} == told_only


@pytest.mark.parametrize("clause", JUDGES)
def test_a_device_of_which_nothing_is_seen_diverges_nowhere_but_in_names(clause: str) -> None:
    found = JUDGES[clause](Observation(Graph("/arm")))
    assert found.verdict is not Verdict.DIVERGES, found


def test_a_slow_machine_is_no_fault_of_the_device() -> None:
    late = replace(sound(), own_lateness=0.5)
    slow = joints("measured_js", lambda e: replace(e, at=10.0 * e.at))(late)
    assert JUDGES["RAT-1"](slow).verdict is Verdict.UNDETERMINED
    some = tool("measured_cv", lambda e: replace(e, stamp_ns=e.stamp_ns + (e.at > 1.5)))(late)
    assert JUDGES["DAT-6"](some).verdict is Verdict.UNDETERMINED
    assert JUDGES["DAT-6"](replace(some, own_lateness=0.0)).verdict is Verdict.DIVERGES


def test_a_recorder_beside_the_device_is_not_the_device() -> None:
    recorder = Endpoint(
        "state_command",
        Direction.COMMANDED,
        TAKEN[2][1],
        HASHES[TAKEN[2][1]],
        "/rosbag2",
        True,
        True,
    )
    seen = graph(lambda g: replace(g, endpoints=(*g.endpoints, recorder)))(sound())
    assert diverging(seen) == set()


def test_a_part_with_a_state_of_its_own_has_its_own_manifest() -> None:
    names = ("gripper/operating_state", "gripper/measured_js")
    kinds = (OFFERED[-1][1], JOINT_TYPE)
    seen = sound()
    for name, kind in zip(names, kinds, strict=True):
        seen = another(name, kind)(seen)
    assert JUDGES["MAN-1"](replace(seen, manifest=MANIFEST)).verdict is Verdict.CONFORMS
    one = another(names[1], JOINT_TYPE)(sound())
    assert JUDGES["MAN-1"](replace(one, manifest=MANIFEST)).verdict is Verdict.DIVERGES
    follows = {**MANIFEST, "followers": ["gripper", "", 3]}
    assert JUDGES["MAN-1"](replace(one, manifest=follows)).verdict is Verdict.CONFORMS
    amiss = {**MANIFEST, "followers": "gripper"}
    assert JUDGES["MAN-1"](replace(one, manifest=amiss)).verdict is Verdict.DIVERGES


def test_evidence_names_the_message() -> None:
    seen = joints("measured_js", lambda e: replace(e, velocity=(0.0,)), every=10)(sound())
    found = JUDGES["DAT-1"](seen)
    assert found.text == "10 of 200 messages"
    assert found.evidence[0] == (
        "measured_js stamped 1699999999.999000: {'name': 3, 'position': 3, 'velocity': 1}"
    )
    assert found.evidence[-1] == "and 5 more"
