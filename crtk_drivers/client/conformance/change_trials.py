"""Trials of changes: much at once, from far, from one kind of command to another, and of how fast it goes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from crtk_drivers.client.conformance.findings import (
    conforms,
    not_offered,
    undetermined,
)
from crtk_drivers.client.conformance.observed import Trace
from crtk_drivers.client.conformance.trial import STREAM_RATE, Stopped, Trial, far, ramp

AMOUNT: Final = 50
"""Positions of a burst."""
PERIODS: Final = 3.0
"""Of the feedback, after which the newest command is the setpoint."""
LEAST_TIME: Final = 0.05
"""Seconds that a message may take."""
FLOOD_RATE: Final = 1000.0
BACKLOG_TIME: Final = 0.1
"""Seconds by which a command may come later in a flood than alone."""
STEPS: Final = 20.0
"""Of a far step."""
FAR_TIME: Final = 0.3
GOAL_RATE: Final = 10.0
GOALS: Final = 15
SLOWEST: Final = 0.2
"""Share of the mean speed below which motion has stopped."""
WINDOW: Final = 0.04
"""Seconds over which a speed is measured."""
AFTER_A_CHANGE: Final = 0.15
JUMP: Final = 1.5
"""Of the highest speed otherwise."""
OVER: Final = 1.1
"""Of the declared velocity that may be measured."""
HALF: Final = 0.5
RATIO: Final = 0.2
SLOWER: Final = 1.5
"""Times as long as at a ratio of 1: five where velocity limits a move, 2.2 where acceleration does."""
EFFORT_TIME: Final = 0.3
TWO_CLIENTS_TIME: Final = 1.0
TURNS: Final = 3
"""Changes of kind of the setpoint while two clients send: from one to the other, and back."""


def first_command(trial: Trial) -> None:
    """STA-11."""
    if trial.lacks(("servo_jp", "setpoint_js"), "STA-11"):
        return
    if not trial.reach("disable", "DISABLED") or not trial.reach("enable", "ENABLED"):
        raise Stopped(f"it stays {trial.word()} after disable and enable")
    here = trial.here()
    goal = _part(here, trial.away(trial.expected.step), 0.25)
    trial.probe.send("servo_jp", goal)
    acts = trial.probe.wait(lambda: _off(trial, goal) <= 0.1 * far(goal, here), 1.0)
    trial.judge(
        "STA-11",
        acts,
        "the first command after ENABLED acts",
        "the first command after ENABLED does nothing",
    )
    trial.go(here)


def burst(trial: Trial) -> None:
    """QOS-5."""
    if trial.lacks(("servo_jp", "setpoint_js"), "QOS-5"):
        return
    here = trial.here()
    away = _part(here, trial.away(trial.expected.step), 0.5)
    trial.stream("servo_jp", [here] * 5)
    began = trial.probe.now()
    for index in range(AMOUNT - 1):
        trial.probe.send("servo_jp", _part(here, away, (index + 1) / AMOUNT))
    trial.probe.send("servo_jp", here)
    sent = trial.probe.now()
    trial.probe.sleep(max(HALF, trial.expected.wait))
    heard = [e for e in trial.probe.trace(began).joints.get("setpoint_js", ()) if e.position]
    if len(heard) < 2:
        trial.note("QOS-5", undetermined(f"{len(heard)} setpoints were heard"))
        return
    period = float(np.median(np.diff([e.at for e in heard])))
    limit = max(trial.still, 0.1 * far(away, here))
    late = [e.at - sent for e in heard if far(e.position, here) > limit]
    last = max(late, default=0.0)
    told = (
        f"{AMOUNT} positions at once: the last is the setpoint after {1e3 * max(0.0, last):.0f} ms"
    )
    good = last <= PERIODS * period + LEAST_TIME
    trial.judge("QOS-5", good, told)
    trial.hold()
    trial.go(here)


def flood(trial: Trial) -> None:
    """INP-7."""
    if trial.lacks(("servo_jp", "setpoint_js"), "INP-7"):
        return
    here = trial.here()
    goal = _part(here, trial.away(trial.expected.step), 0.25)
    trial.stream("servo_jp", [here] * 5)
    alone = _delay(trial, here, goal)
    trial.stream("servo_jp", ramp(goal, here, 0.2))
    count = int(trial.expected.flood_time * FLOOD_RATE)
    for _ in trial.paced(range(count), FLOOD_RATE):
        trial.probe.send("servo_jp", here)
    delay = _delay(trial, here, goal)
    told = f"alone after {1e3 * alone:.0f} ms, after {count} commands after {1e3 * delay:.0f} ms"
    good = delay <= alone + BACKLOG_TIME
    trial.judge("INP-7", good, told)
    trial.hold()
    trial.go(here)


def _delay(trial: Trial, here: Sequence[float], goal: Sequence[float]) -> float:
    """Return after how long a command is the setpoint: s."""
    began = trial.probe.now()
    trial.probe.send("servo_jp", goal)
    trial.probe.wait(
        lambda: _off(trial, goal) <= 0.1 * far(goal, here), trial.expected.flood_time + 1.0
    )
    return trial.probe.now() - began


def far_step(trial: Trial) -> None:
    """MOV-15."""
    if trial.lacks(("servo_jp",), "MOV-15"):
        return
    declared = trial.velocity
    if declared is None:
        trial.note("MOV-15", undetermined("no velocity of the joint is declared"))
        return
    here, goal = trial.here(), trial.away(STEPS * trial.expected.step)
    began = trial.probe.now()
    trial.stream("servo_jp", [goal] * int(FAR_TIME * STREAM_RATE))
    trial.hold()
    trial.at_rest()
    trace = trial.probe.trace(began)
    moved = trial.displaced(began, here)
    if moved <= trial.still:
        trial.note("MOV-15", conforms(f"a step of {far(goal, here):.2f} is refused"))
    else:
        peak = max((speed for _, speed in speeds(trace, trial.joint)), default=0.0)
        told = f"a step of {far(goal, here):.2f}: at {peak:.2f} at most, {declared:.2f} is declared"
        trial.judge("MOV-15", peak <= OVER * declared, told)
    trial.enable()
    trial.go(here)


def interpolated(trial: Trial) -> None:
    """MOV-20."""
    if trial.lacks(("interpolate_jp",), "MOV-20"):
        return
    here, target = trial.here(), trial.away(trial.expected.stroke)
    began = trial.probe.now()
    for index in trial.paced(range(GOALS), GOAL_RATE):
        trial.probe.send("interpolate_jp", _part(here, target, (index + 1) / GOALS))
    ended = trial.probe.now()
    trial.at_rest()
    third = (ended - began) / 3.0
    found = speeds(trial.probe.trace(began), trial.joint)
    middle = [speed for at, speed in found if began + third <= at <= ended - third]
    if len(middle) < GOALS:
        trial.note("MOV-20", undetermined(f"{len(middle)} speeds on the way are too few"))
    else:
        mean, least = float(np.mean(middle)), min(middle)
        told = f"goals at {GOAL_RATE:.0f} Hz: at {100 * least / max(mean, 1e-9):.0f} % of its speed"
        good = mean > 0.0 and least >= SLOWEST * mean
        trial.judge("MOV-20", good, told, f"{told} it nearly stops")
    trial.go(here)


def changes_of_kind(trial: Trial) -> None:
    """MOV-21."""
    if trial.lacks(("servo_jp", "move_jp", "servo_jv", "hold"), "MOV-21"):
        return
    here, target = trial.here(), trial.away(trial.expected.stroke)
    velocity = tuple(np.subtract(trial.away(trial.expected.step), here) / HALF)
    began = trial.probe.now()
    trial.stream("servo_jp", ramp(here, target, 1.2))
    changes = [trial.probe.now()]
    trial.probe.send("move_jp", here)
    trial.arrives(here)
    changes.append(trial.probe.now())
    trial.stream("servo_jv", [velocity] * int(STREAM_RATE * HALF))
    changes.append(trial.probe.now())
    trial.hold()
    trial.at_rest()
    found = speeds(trial.probe.trace(began), trial.joint)
    soon = [v for at, v in found if any(0.0 <= at - each <= AFTER_A_CHANGE for each in changes)]
    else_ = [v for at, v in found if not any(0.0 <= at - c <= AFTER_A_CHANGE for c in changes)]
    if not soon or not else_:
        trial.note("MOV-21", undetermined("too little was heard"))
    else:
        told = f"at {max(soon):.3f} at most after a change, at {max(else_):.3f} otherwise"
        limit = JUMP * max(else_) + 2.0 * trial.still / WINDOW
        trial.judge("MOV-21", max(soon) <= limit, told)
    trial.go(here)


def two_clients(trial: Trial) -> None:
    """MOV-25."""
    if trial.lacks(("servo_jp", "servo_jv", "setpoint_js"), "MOV-25"):
        return
    here = trial.here()
    velocity = tuple(np.subtract(trial.away(trial.expected.step), here) / TWO_CLIENTS_TIME)
    began = trial.probe.now()
    count = int(2.0 * TWO_CLIENTS_TIME * STREAM_RATE)
    for index in trial.paced(range(count), 2.0 * STREAM_RATE):
        if index % 2:
            trial.probe.send("servo_jv", velocity, second=True)
        else:
            trial.probe.send("servo_jp", here)
    ended = trial.probe.now()
    trial.hold()
    trial.at_rest()
    heard = trial.probe.trace(began).joints.get("setpoint_js", ())
    kinds = [any(e.velocity) for e in heard if e.at <= ended and (e.position or e.velocity)]
    if len(kinds) < 2 * TURNS:
        trial.note("MOV-25", undetermined(f"{len(kinds)} setpoints were heard"))
    else:
        turns = sum(now is not before for before, now in pairwise(kinds))
        told = f"the setpoint changes its kind {turns} times in {TWO_CLIENTS_TIME:g} s"
        trial.judge("MOV-25", turns <= TURNS, told)
    trial.enable()
    trial.go(here)


def slower_moves(trial: Trial) -> None:
    """MOV-24."""
    name = "trajectory_j/set_ratio"
    if name not in trial.topics or not trial.offers("move_jp"):
        trial.note("MOV-24", not_offered(f"not both move_jp and {name}"))
        return
    before = trial.probe.number("trajectory_j/ratio")
    here, target = trial.here(), trial.away(trial.expected.stroke)
    times = []
    try:
        for ratio in (1.0, RATIO):
            trial.probe.send(name, (ratio,))
            trial.probe.sleep(0.2)
            times.append(_duration(trial, target))
            trial.probe.send(name, (1.0,))
            _duration(trial, here)
    finally:
        trial.probe.send(name, (1.0 if before is None else before,))
    told = f"{times[0]:.2f} s at a ratio of 1, {times[1]:.2f} s at {RATIO}"
    slower = times[1] >= SLOWER * times[0]
    trial.judge("MOV-24", slower, told)
    trial.go(here)


def _duration(trial: Trial, target: Sequence[float]) -> float:
    """Move, and return how long the joints were on their way: s."""
    before, began = trial.here(), trial.probe.now()
    trial.probe.send("move_jp", target)
    trial.arrives(target)
    trial.at_rest()
    heard = [e for e in trial.probe.trace(began).joints.get("measured_js", ()) if e.stamp_ns]
    length = far(target, before)
    way = [e.at for e in heard if 0.05 * length < far(e.position, before) < 0.95 * length]
    return max(way[-1] - way[0], 1e-3) if way else 1e-3


def efforts(trial: Trial) -> None:
    """SPT-4."""
    heard = trial.probe.joints("measured_js")
    if trial.lacks(("servo_jf", "setpoint_js"), "SPT-4"):
        return
    if heard is None or len(heard.effort) != len(heard.position):
        trial.note("SPT-4", undetermined("no effort is measured that would hold it"))
        return
    here, began = trial.here(), trial.probe.now()
    trial.stream("servo_jf", [heard.effort] * int(EFFORT_TIME * STREAM_RATE))
    ended = trial.probe.now()
    trial.hold()
    trial.at_rest()
    told = trial.probe.trace(began).joints.get("setpoint_js", ())
    middle = 0.5 * (began + ended)
    during = [e for e in told if e.stamp_ns and middle <= e.at <= ended]
    if not during:
        trial.note("SPT-4", undetermined("no valid setpoint_js meanwhile"))
    else:
        wrong = [e for e in during if e.position or e.velocity or not e.effort]
        words = f"{len(wrong)} of {len(during)} setpoints are not of effort alone"
        trial.judge("SPT-4", not wrong, "effort alone", words)
    trial.go(here)


def speeds(trace: Trace, joint: int) -> list[tuple[float, float]]:
    """Return when a joint was how fast: arrivals in s, means of `WINDOW` in rad/s or m/s, without sign."""
    heard = [e for e in trace.joints.get("measured_js", ()) if e.stamp_ns and e.position]
    if len(heard) < 2:
        return []
    stamps = np.array([e.stamp_ns for e in heard]) / 1e9
    places = np.array([e.position[joint] for e in heard])
    before = np.searchsorted(stamps, stamps - WINDOW, side="right") - 1
    return [
        (
            heard[now].at,
            float(abs(places[now] - places[then]) / max(stamps[now] - stamps[then], WINDOW)),
        )
        for now, then in enumerate(before)
        if then >= 0
    ]


def _part(begin: Sequence[float], end: Sequence[float], share: float) -> tuple[float, ...]:
    return tuple(b + share * (e - b) for b, e in zip(begin, end, strict=True))


def _off(trial: Trial, goal: Sequence[float]) -> float:
    """Return how far the newest setpoint is from a goal."""
    newest = trial.probe.joints("setpoint_js")
    return far(() if newest is None else newest.position, goal)
