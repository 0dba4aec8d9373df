"""Trials of moves: that they arrive, are busy, and end when they shall; and which commands do anything."""

from __future__ import annotations

import math
from collections.abc import Callable
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
from crtk_drivers.client.conformance.observed import Trace
from crtk_drivers.client.conformance.trial import Trial, far
from crtk_drivers.commands import Kind, Level

BUSY_FALLS: Final = 0.5
"""Seconds between arrival and the end of busy, either way."""
HERE_TIME: Final = 5.0
TOO_QUICK: Final = 0.25
"""Seconds in which a device need not have heard of a second goal, and turned."""
ACTS_WITHIN: Final = 2.0
"""Seconds after which a command that has done nothing will do nothing."""
PART_OF_WAY: Final = 0.2
"""After which a move is interrupted."""
SOON: Final = 0.15
"""Seconds in which a stop may not have come to a device on a busy machine."""


def arrives(trial: Trial) -> None:
    """MOV-16, BSY-2, GOL-1, SPT-6."""
    if trial.lacks(("move_jp",), "MOV-16", "BSY-2", "GOL-1", "SPT-6"):
        return
    begin, target = trial.here(), trial.away(trial.expected.stroke)
    began = trial.probe.now()
    trial.probe.send("move_jp", target)
    arrived = trial.arrives(target)
    at = trial.probe.now()
    trial.probe.wait(lambda: not trial.is_busy, BUSY_FALLS + trial.expected.wait)
    stands = trial.at_rest()
    trace = trial.probe.trace(began)
    off = far(trial.here(), target)
    near = arrived and stands and off <= trial.expected.arrival
    told = f"{off:.1e} from the goal"
    trial.judge("MOV-16", near, told, told if stands else "it does not stand")
    if stands and off < 0.5 * far(begin, target):
        trial.note("BSY-2", _busy_meanwhile(trace, at))
        trial.note("SPT-6", _on_the_way(trace, trial.joint, target))
    trial.note("GOL-1", _goal(trial, "goal_js", target))
    trial.go(begin)


def _busy_meanwhile(trace: Trace, arrived: float) -> Finding:
    busy = [each.at for each in trace.states if each.is_busy]
    if not busy:
        return diverges("never busy")
    after = [each.at for each in trace.states if not each.is_busy and each.at > busy[-1]]
    if not after:
        return diverges("busy for ever")
    return conforms(
        f"busy {busy[0] - trace.began:.2f} s after the command, to {after[0] - arrived:+.2f} s of arrival"
    )


def _on_the_way(trace: Trace, joint: int, target: tuple[float, ...]) -> Finding:
    heard = [e for e in trace.joints.get("setpoint_js", ()) if e.stamp_ns]
    if not heard:
        return not_offered("no valid setpoint_js")
    first = next((e.position for e in heard if e.position), ())
    way = [e for e in heard if e.position and abs(e.position[joint] - target[joint]) > 1e-4]
    way = [e for e in way if e.position != first]
    if len({e.position for e in way}) < 5:
        return undetermined(f"{len(way)} setpoints on the way are too few")
    left = np.array([abs(e.position[joint] - target[joint]) for e in way])
    if np.any(np.diff(left) > 1e-6):
        return diverges("the position of setpoint_js turns back on the way")
    if not all(len(e.velocity) == len(e.position) for e in way):
        return diverges("setpoint_js has no velocity on the way")
    return conforms(f"{len(way)} setpoints on the way, with velocity")


def _goal(trial: Trial, name: str, target: tuple[float, ...]) -> Finding:
    if not trial.offers(name):
        return not_offered(f"no {name}")

    def off() -> float:
        if name == "goal_js":
            joints = trial.probe.joints(name)
            return math.inf if joints is None else far(joints.position, target)
        pose = trial.probe.cartesian(name)
        return math.inf if pose is None else max(pose_distance(pose.numbers, target))

    trial.probe.wait(lambda: off() <= 1e-6, trial.expected.wait)
    told = f"{name} is {off():.1e} from what was asked"
    return conforms(told) if off() <= 1e-6 else diverges(told)


def to_where_it_is(trial: Trial) -> None:
    """BSY-3."""
    if trial.lacks(("move_jp", "operating_state"), "BSY-3"):
        return
    began = trial.probe.now()
    trial.probe.send("move_jp", trial.here())
    trial.probe.wait(
        lambda: any(e.is_busy for e in trial.probe.trace(began).states), trial.expected.wait
    )
    trial.probe.wait(lambda: not trial.is_busy, HERE_TIME)
    trial.probe.sleep(trial.expected.wait / 2.0)
    said = [each.is_busy for each in trial.probe.trace(began).states]
    edges = [now for before, now in zip([False, *said], said, strict=False) if now is not before]
    if edges == [True, False]:
        trial.note("BSY-3", conforms("rises and falls once"))
    elif not edges:
        trial.note(
            "BSY-3", diverges("never busy: who waits for the end of the move waits for ever")
        )
    else:
        trial.note(
            "BSY-3", diverges(f"busy {'stays' if edges[-1] else f'changes {len(edges)} times'}")
        )


def pre_empted(trial: Trial) -> None:
    """MOV-18."""
    if trial.lacks(("move_jp",), "MOV-18"):
        return
    begin, target = trial.here(), trial.away(trial.expected.stroke)
    if not _on_its_way(trial, begin, target):
        trial.note("MOV-18", undetermined("it was at its goal before a second could be sent"))
        return
    began = trial.probe.now()
    trial.probe.send("move_jp", begin)
    trial.probe.sleep(trial.expected.wait / 4.0)
    trial.probe.wait(lambda: not trial.is_busy, trial.expected.move_time)
    trial.at_rest()
    heard = trial.probe.trace(began).joints.get("measured_js", ())
    reached = [e.at - began for e in heard if far(e.position, target) <= trial.expected.arrival]
    off = far(trial.here(), begin)
    if off > trial.expected.arrival:
        trial.note("MOV-18", diverges(f"it ends {off:.4f} from the second goal"))
    elif not reached:
        trial.note("MOV-18", conforms("the second goal ends the first"))
    elif reached[0] < TOO_QUICK:
        told = f"it was at its first goal {reached[0]:.2f} s after the second was sent: a longer stroke?"
        trial.note("MOV-18", undetermined(told))
    else:
        trial.note("MOV-18", diverges("it went to the first goal, although a second had been sent"))
    trial.go(begin)


def _on_its_way(trial: Trial, begin: tuple[float, ...], target: tuple[float, ...]) -> bool:
    """Send a move, and return whether it is under way, not at its goal."""
    length = far(begin, target)
    trial.probe.send("move_jp", target)
    trial.probe.wait(
        lambda: far(trial.here(), begin) >= PART_OF_WAY * length, trial.expected.move_time
    )
    return far(trial.here(), target) > trial.expected.arrival and far(trial.here(), begin) > 0.0


def held(trial: Trial) -> None:
    """MOV-22, BSY-5."""
    if trial.lacks(("move_jp", "hold"), "MOV-22", "BSY-5"):
        return
    begin, target = trial.here(), trial.away(trial.expected.stroke)
    _on_its_way(trial, begin, target)
    trial.note("MOV-22", _stopped(trial, lambda: trial.hold(), target, "hold"))
    word = trial.word()
    if word != "ENABLED":
        trial.note("MOV-22", diverges(f"hold leads to {word}"))
    free = trial.probe.wait(lambda: not trial.is_busy, trial.expected.stop_time)
    trial.judge("BSY-5", free, "not busy after hold", "busy after hold")
    trial.enable()
    trial.go(begin)


def disabled_on_the_way(trial: Trial) -> None:
    """STA-13."""
    if trial.lacks(("move_jp", "state_command"), "STA-13"):
        return
    begin, target = trial.here(), trial.away(trial.expected.stroke)
    _on_its_way(trial, begin, target)
    disable = lambda: trial.probe.send("state_command", text="disable")  # noqa: E731
    trial.note("STA-13", _stopped(trial, disable, target, "disable"))
    trial.probe.wait(lambda: trial.word() == "DISABLED", trial.expected.transition_time)
    trial.enable()
    trial.go(begin)


def _stopped(
    trial: Trial, stop: Callable[[], object], target: tuple[float, ...], what: str
) -> Finding:
    left = far(trial.here(), target)
    began = trial.probe.now()
    stop()
    trial.probe.sleep(trial.expected.stop_time)
    stands = trial.at_rest()
    end = far(trial.here(), target)
    heard = trial.probe.trace(began).joints.get("measured_js", ())
    last = [e.at for e in heard if far(e.position, trial.here()) > trial.still]
    took = (last[-1] if last else began) - began
    if end <= trial.expected.arrival:
        if left <= 2.0 * trial.expected.arrival:
            return undetermined("the move was over before")
        if took < SOON:
            told = f"it was at its goal {took:.2f} s after {what}, which may not have come by then"
            return undetermined(f"{told}: a longer `stroke` tells more")
        return diverges(f"it goes on to its goal after {what}")
    if not stands or took > trial.expected.stop_time:
        return diverges(f"it moves for {took:.2f} s after {what}")
    return conforms(f"at rest {took:.2f} s after {what}, {end:.3f} from the goal")


def relative_moves(trial: Trial) -> None:
    """MOV-19."""
    if trial.lacks(("move_jr",), "MOV-19"):
        return
    begin, target = trial.here(), trial.away(trial.expected.stroke)
    way = tuple(np.subtract(target, begin))
    goal = tuple(np.add(begin, 2.0 * np.array(way)))
    trial.probe.send("move_jr", way)
    trial.arrives(target)
    trial.probe.wait(lambda: not trial.is_busy, trial.expected.wait)
    trial.at_rest()
    trial.probe.send("move_jr", way)
    trial.arrives(goal)
    trial.at_rest()
    off = far(trial.here(), goal)
    told = f"after two in a row {off:.1e} from their sum"
    trial.judge("MOV-19", off <= trial.expected.arrival, told)
    trial.probe.send("move_jr", tuple(-2.0 * np.array(way)))
    trial.arrives(begin)
    trial.at_rest()


def poses(trial: Trial) -> None:
    """MOV-17."""
    if trial.lacks(("move_cp", "measured_cp"), "MOV-17"):
        return
    begin, joints = trial.pose(), trial.here()
    target = list(begin)
    target[2] += trial.expected.linear_step
    trial.probe.send("move_cp", target)

    def off() -> float:
        return pose_distance(trial.pose(), target)[0]

    near = 0.1 * trial.expected.linear_step
    trial.probe.wait(lambda: off() <= near, trial.expected.move_time)
    trial.at_rest()
    told = f"{1e3 * off():.2f} mm from the goal"
    if off() <= 2.0 * near:
        trial.note("MOV-17", conforms(told))
    elif pose_distance(trial.pose(), begin)[0] <= near:
        trial.note("MOV-17", undetermined(f"it did not move: refused? ({told})"))
    else:
        trial.note("MOV-17", diverges(told))
    trial.go(joints)


def refused_goal(trial: Trial) -> None:
    """GOL-2."""
    if trial.lacks(("move_jp", "goal_js"), "GOL-2"):
        return
    before = trial.probe.joints("goal_js")
    bad = (*trial.here()[:-1], math.nan)
    trial.probe.send("move_jp", bad)
    trial.probe.sleep(trial.expected.wait / 2.0)
    after = trial.probe.joints("goal_js")
    same = before is after or (
        before is not None and after is not None and before.position == after.position
    )
    trial.judge("GOL-2", same, "unchanged", "a refused goal is told")


def dead_topics(trial: Trial) -> None:
    """SET-1."""
    dead = []
    for name, row in trial.motions().items():
        joints, began = trial.here(), trial.probe.now()
        before = _told_setpoints(trial)
        size = 1.0 if row.level is Level.MOVE or row.kind is Kind.VELOCITY else 0.25
        goal = trial.sample(row, size)
        times = 1 if row.level is Level.MOVE or row.kind is Kind.RELATIVE else 10
        trial.stream(name, [goal] * times)
        acted = trial.probe.wait(
            lambda began=began, joints=joints, before=before: (  # type: ignore[misc]
                trial.displaced(began, joints) > trial.still
                or _told_setpoints(trial) != before
                or bool(trial.probe.trace(began).told)
            ),
            ACTS_WITHIN,
        )
        if not acted:
            dead.append(name)
        trial.hold()
        trial.at_rest()
        trial.go(joints)
    if dead:
        trial.note("SET-1", diverges(f"neither obeyed nor refused: {', '.join(dead)}"))
    else:
        trial.note("SET-1", conforms(f"{len(trial.motions())} commands act, or are refused"))


def _told_setpoints(trial: Trial) -> tuple[tuple[float, ...], ...]:
    joints, pose = trial.probe.joints("setpoint_js"), trial.probe.cartesian("setpoint_cp")
    goal = trial.probe.joints("goal_js")
    return (
        joints.position + joints.velocity if joints is not None else (),
        pose.numbers if pose is not None and pose.stamp_ns else (),
        goal.position if goal is not None else (),
    )
