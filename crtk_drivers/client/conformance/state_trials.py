"""Trials of the operating state, and of commands that must move nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from crtk_drivers.client.conformance.findings import (
    Finding,
    conforms,
    diverges,
    not_offered,
    undetermined,
)
from crtk_drivers.client.conformance.trial import Stopped, Trial, far
from crtk_drivers.commands import Command, Kind, Level, Space

WRONG_WORDS: Final = ("ENABLE", " enable", "Enable", "enabled", "")
TOLD_WITHIN: Final = 1.0
"""Seconds."""
AT_ONCE: Final = 0.2
"""Seconds in which a device may be homed without having been seen busy."""
JAWS: Final = ("jaw", "gripper")
"""Sub-namespaces of what opens and closes."""
STREAM_LENGTH: Final = 5
"""Messages of a stream that must be refused."""


def in_fault(trial: Trial) -> None:
    """STA-9, of a device that is found in FAULT. It is brought out of it, if it lets itself be."""
    for word in ("pause", "resume"):
        states = trial.said(word)
        if states != ["FAULT"]:
            trial.note("STA-9", diverges(f"{word!r} in FAULT: then {', '.join(states[1:])}"))
            return
    out = trial.reach("enable", "ENABLED") or trial.reach("disable", "DISABLED")
    told = f"pause and resume change nothing; after enable or disable it is {trial.word()}"
    trial.note("STA-9", conforms(told))
    if not out:
        raise Stopped("it stays in FAULT")


def in_disabled(trial: Trial) -> None:
    """STA-6, STA-12, STA-14, RAT-2, and MOV-1 in DISABLED."""
    _disable(trial)
    began = trial.probe.now()
    for word in ("pause", "resume"):
        trial.note("STA-6", _stays(trial, word, "DISABLED"))
    trial.probe.wait(lambda: bool(trial.probe.trace(began).told), TOLD_WITHIN)
    told = [text for _, text in trial.probe.trace(began).told]
    trial.note(
        "STA-14",
        conforms(told[0][:120])
        if told
        else diverges("nothing is said of an invalid command, neither on refusals nor on /rosout"),
    )
    for word in WRONG_WORDS:
        trial.note("STA-12", _stays(trial, word, "DISABLED"))
    began = trial.probe.now()
    trial.settle(trial.expected.wait)
    heard = trial.probe.trace(began).measured()
    silent = [name for name in trial.commands if name.startswith("measured_") and name not in heard]
    if silent:
        trial.note("RAT-2", diverges(f"silent while DISABLED: {', '.join(silent)}"))
    elif heard:
        trial.note("RAT-2", conforms(f"{len(heard)} topics go on while DISABLED"))
    moves_nothing(trial, "DISABLED")


def _disable(trial: Trial) -> None:
    if trial.word() != "DISABLED" and not trial.reach("disable", "DISABLED"):
        trial.note("STA-7", diverges(f"disable leads to {trial.word()}"))
        raise Stopped("it cannot be disabled")


def jaw_in_disabled(trial: Trial) -> None:
    """SUB-2, in DISABLED."""
    following = [
        jaw
        for jaw in JAWS
        if f"{jaw}/measured_js" in trial.topics and f"{jaw}/operating_state" not in trial.topics
    ]
    commands = [
        (jaw, name)
        for jaw in following
        for name in (f"{jaw}/servo_jp", f"{jaw}/move_jp")
        if name in trial.topics
    ]
    if not commands:
        trial.note("SUB-2", not_offered("no jaw or gripper that is moved and has no state"))
    _disable(trial)
    for jaw, name in commands:
        before = trial.probe.joints(f"{jaw}/measured_js")
        if before is None or not before.position:
            trial.note("SUB-2", undetermined(f"{jaw}/measured_js is silent"))
            continue
        goal = [each + trial.expected.step for each in before.position]
        began = trial.probe.now()
        trial.stream(name, [goal] * (STREAM_LENGTH if name.endswith("servo_jp") else 1))
        trial.settle(trial.expected.wait)
        heard = trial.probe.trace(began).joints.get(f"{jaw}/measured_js", ())
        moved = max((far(each.position, before.position) for each in heard), default=math.nan)
        if not moved > trial.still:
            told = f"{name} in DISABLED moves nothing"
            trial.note("SUB-2", conforms(told) if heard else undetermined(f"{jaw} went silent"))
            continue
        trial.note("SUB-2", diverges(f"{name} in DISABLED moves a joint by {moved:.4f}"))
        raise Stopped(f"{name} moved it while DISABLED")


def homing(trial: Trial) -> None:
    """HOM-2, in ENABLED."""
    if not trial.leave.may_home:
        trial.note("HOM-2", undetermined("needs --may-home: it moves as it likes"))
        return
    trial.probe.send("state_command", text="unhome")
    if not trial.probe.wait(lambda: not trial.is_homed, trial.expected.wait):
        told = "it stays homed after unhome"
        trial.note(
            "HOM-2",
            not_offered(f"{told}, and needs no homing, as its manifest says")
            if trial.needs_homing is False
            else diverges(told)
            if trial.needs_homing
            else undetermined(f"{told}; whether it needs homing is not declared"),
        )
        return
    trial.enable()
    began = trial.probe.now()
    trial.probe.send("state_command", text="home")
    homed = trial.probe.wait(lambda: trial.is_homed, trial.expected.home_time)
    took = trial.probe.now() - began
    was_busy = any(each.is_busy for each in trial.probe.trace(began).states)
    if not homed:
        trial.note("HOM-2", diverges(f"not homed within {took:.0f} s after home"))
        raise Stopped("it is not homed")
    if not was_busy and took > AT_ONCE:
        trial.note("HOM-2", diverges(f"homed {took:.2f} s after home, and never busy meanwhile"))
        return
    trial.probe.wait(lambda: not trial.is_busy, trial.expected.wait)
    trial.judge(
        "HOM-2",
        not trial.is_busy,
        f"unhome clears is_homed, home sets it after {took:.2f} s",
        "still busy after home",
    )


def enabling(trial: Trial) -> None:
    """STA-5, MOV-2, SPT-9."""
    before, began = trial.here(), trial.probe.now()
    if not trial.reach("enable", "ENABLED"):
        trial.note("STA-5", diverges(f"enable leads to {trial.word()}"))
        raise Stopped(f"it stays {trial.word()} after enable")
    took = trial.probe.now() - began
    trial.note("STA-5", conforms(f"ENABLED after {took:.2f} s"))
    _nothing_moves(trial, "MOV-2", "enable", before, began)
    if trial.lacks(("setpoint_js",), "SPT-9"):
        return
    heard = [
        e
        for e in trial.probe.trace(began).joints.get("setpoint_js", ())
        if e.stamp_ns and e.position
    ]
    if not heard:
        trial.note("SPT-9", undetermined("no valid setpoint_js after enable"))
        return
    off = far(heard[-1].position, trial.here())
    told = f"setpoint and measurement are {off:.1e} apart"
    near = off <= max(trial.still, trial.expected.arrival)
    trial.judge("SPT-9", near, told)


def in_enabled(trial: Trial) -> None:
    """STA-7, and STA-8 where there is a pause."""
    trial.enable()
    for word in ("enable", "resume"):
        trial.note("STA-7", _stays(trial, word, "ENABLED"))
    if not trial.reach("pause", "PAUSED"):
        trial.note("STA-7", diverges(f"pause leads to {trial.word()}"))
        trial.note("STA-8", not_offered("it is never PAUSED"))
        trial.enable()
        return
    trial.note("STA-7", conforms("pause leads to PAUSED"))
    for word in ("enable", "pause"):
        found = _stays(trial, word, "PAUSED")
        trial.note("STA-8", found)
        if trial.word() != "PAUSED":
            trial.reach("pause", "PAUSED")
    moves_nothing(trial, "PAUSED")
    before, began = trial.here(), trial.probe.now()
    trial.note("STA-8", _leads(trial, "resume", "ENABLED"))
    if trial.word() == "ENABLED":
        _nothing_moves(trial, "MOV-2", "resume", before, began)
        trial.reach("pause", "PAUSED")
    if trial.word() == "PAUSED":
        trial.note("STA-8", _leads(trial, "disable", "DISABLED"))
    trial.enable()
    trial.note("STA-7", _leads(trial, "disable", "DISABLED"))
    trial.enable()


def _leads(trial: Trial, word: str, state: str) -> Finding:
    reached = trial.reach(word, state)
    return (
        conforms(f"{word} leads to {state}")
        if reached
        else diverges(f"{word} leads to {trial.word()}")
    )


def _stays(trial: Trial, word: str, state: str) -> Finding:
    """Send a command that must change nothing; bring the state back if it does."""
    states = trial.said(word)
    if states != [state]:
        back = {"DISABLED": "disable", "ENABLED": "enable", "PAUSED": "pause"}[state]
        found = diverges(f"{word!r} in {state}: then {', '.join(states[1:]) or 'nothing'}")
        if trial.word() != state:
            trial.reach(back, state)
        return found
    return conforms(f"{word!r} in {state} changes nothing")


def _nothing_moves(
    trial: Trial, clause: str, what: str, before: Sequence[float], began: float
) -> None:
    trial.settle(2.0 * trial.expected.wait)
    moved = trial.displaced(began, before)
    if moved > trial.still:
        trial.note(clause, diverges(f"{what} moves a joint by {moved:.4f}"))
        raise Stopped(f"{what} moved it")
    trial.note(clause, conforms(f"{what} moves nothing ({moved:.1e})"))


def moves_nothing(trial: Trial, state: str) -> None:
    """MOV-1: every command by one step, in a state in which nothing moves."""
    for name, row in trial.motions().items():
        before, began = trial.here(), trial.probe.now()
        numbers = trial.sample(row, 1.0)
        times = 1 if row.level is Level.MOVE else STREAM_LENGTH
        trial.stream(name, [numbers] * times)
        trial.settle(trial.expected.wait / 2.0)
        moved = trial.displaced(began, before)
        if moved > trial.still:
            trial.note("MOV-1", diverges(f"{name} in {state} moves a joint by {moved:.4f}"))
            raise Stopped(f"{name} moved it while {state}")
        trial.note("MOV-1", conforms(f"nothing moves in {state}"))


def bad_input(trial: Trial) -> None:
    """INP-1 to INP-6, INP-8 and INP-9, in ENABLED and at rest."""
    trial.enable()
    began = trial.probe.now()
    for name, row in trial.motions().items():
        for clause, what, numbers, fields in _bad(trial, row):
            _refused(trial, clause, name, what, numbers, fields)
    if "INP-6" not in trial.found:
        trial.note(
            "INP-6", undetermined("the range of the joint is not known, or there is no move_jp")
        )
    told = [text for _, text in trial.probe.trace(began).told]
    if told:
        trial.note(
            "INP-8", conforms(f"{len(told)} refusals or log records, such as: {told[0][:120]}")
        )
    else:
        trial.note(
            "INP-8", diverges("nothing is said of any refusal, neither on refusals nor on /rosout")
        )
    ended = trial.probe.now()
    trial.settle(trial.expected.wait)
    alive = trial.probe.trace(ended)
    if trial.word() != "ENABLED":
        trial.note("INP-9", diverges(f"it is {trial.word()} after bad input"))
        raise Stopped("it did not survive bad input")
    publishes = bool(alive.joints.get("measured_js"))
    trial.judge("INP-9", publishes, "still ENABLED", "it went silent")


Bad = tuple[str, str, tuple[float, ...], dict[str, object]]


def _bad(trial: Trial, row: Command) -> list[Bad]:
    good = trial.sample(row, 1.0)
    found: list[Bad] = []
    for what, value in (("NaN", math.nan), ("infinity", math.inf)):
        found.append(("INP-1", what, (*good[:-1], value), {}))
    if row.space is Space.JOINT:
        found.append(("INP-2", "one too few", good[:-1], {}))
        found.append(("INP-2", "one too many", (*good, 0.0), {}))
        found.append(("INP-2", "none", (), {}))
    if row.space is Space.CARTESIAN and row.kind in (Kind.POSITION, Kind.RELATIVE):
        found.append(("INP-3", "zero quaternion", (*good[:3], 0.0, 0.0, 0.0, 0.0), {}))
    if row.space is Space.CARTESIAN and row.kind is Kind.POSITION:
        here = trial.pose()
        long = tuple(1.01 * each for each in here[3:])
        found.append(("INP-4", "quaternion of norm 1.01", (*here[:3], *long), {}))
        found.append(("INP-5", "another frame", good, {"frame": "elsewhere"}))
    if row.name == "move_jp" and len(trial.ranges) == len(good):
        room = trial.ranges[trial.joint]
        beyond = list(good)
        beyond[trial.joint] = room.upper + (room.upper - room.lower)
        found.append(("INP-6", "beyond the range", tuple(beyond), {}))
    return found


def _refused(
    trial: Trial,
    clause: str,
    name: str,
    what: str,
    numbers: tuple[float, ...],
    fields: dict[str, object],
) -> None:
    before, began = trial.here(), trial.probe.now()
    trial.stream(name, [numbers], **fields)
    trial.settle(trial.expected.wait / 4.0)
    moved = trial.displaced(began, before)
    if not moved > trial.still:
        trial.note(clause, conforms("nothing moves"))
        return
    trial.hold()
    trial.at_rest()
    if clause == "INP-6":
        trial.note(
            clause, undetermined(f"{name} beyond the range moves it: it was held on the way")
        )
    else:
        trial.note(clause, diverges(f"{name} with {what} moves a joint by {moved:.4f}"))
    trial.go(before)
    if clause == "INP-1":
        raise Stopped(f"{name} with {what} moved it")
