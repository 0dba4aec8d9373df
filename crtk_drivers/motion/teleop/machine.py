"""The states of a coupled leader and follower, as data, and one step from what was heard to what is sent.

No clock is read here and nothing waits: `step` may be called with any times, and tests do.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Final

from crtk_drivers.motion.teleop import coupling, jaws
from crtk_drivers.motion.teleop.both_sides import Commands, Heard, Inputs, Side
from crtk_drivers.motion.teleop.teleop_settings import PedalSettings, TeleopSettings
from crtk_drivers.samples import JointState, Pose, Twist, Wrench
from crtk_drivers.state import OperatingState

STILL_TIME: Final = 0.1
"""Seconds in which the follower must have stayed within `STILL` before they are coupled."""
STILL: Final = (1e-3, 5e-3)
"""Metres and radians."""
AT_SETPOINT: Final = (0.01, 0.05)
"""A setpoint nearer than this, in m and rad, to what is measured is where the follower begins."""


class Phase(StrEnum):
    """What they do."""

    HELD = "HELD"
    """Something is missing, or went wrong. The pedals must be let go before anything moves again."""
    RELEASED = "RELEASED"
    """Both are ready, and the pedals uncouple them."""
    ALIGNING = "ALIGNING"
    """The pedals couple them, and the follower still moves, or the leader is turned otherwise."""
    FOLLOWING = "FOLLOWING"
    """The follower goes with the leader."""


class Event(StrEnum):
    """What a step has found."""

    TROUBLE = "trouble"
    LET_GO = "let go"
    WANTED = "wanted"
    READY = "ready"


TRANSITIONS: Final[Mapping[Phase, Mapping[Event, Phase]]] = MappingProxyType(
    {
        Phase.HELD: {
            Event.TROUBLE: Phase.HELD,
            Event.LET_GO: Phase.RELEASED,
            Event.WANTED: Phase.HELD,
            Event.READY: Phase.HELD,
        },
        Phase.RELEASED: {
            Event.TROUBLE: Phase.HELD,
            Event.LET_GO: Phase.RELEASED,
            Event.WANTED: Phase.ALIGNING,
            Event.READY: Phase.FOLLOWING,
        },
        Phase.ALIGNING: {
            Event.TROUBLE: Phase.HELD,
            Event.LET_GO: Phase.RELEASED,
            Event.WANTED: Phase.ALIGNING,
            Event.READY: Phase.FOLLOWING,
        },
        Phase.FOLLOWING: {
            Event.TROUBLE: Phase.HELD,
            Event.LET_GO: Phase.RELEASED,
            Event.WANTED: Phase.FOLLOWING,
            Event.READY: Phase.FOLLOWING,
        },
    }
)


@dataclass(frozen=True, slots=True)
class Coupled:
    """Where they are. Made anew by each step.

    Attributes:
        phase: see `Phase`.
        reason: why it is that one, for people; empty while they are coupled.
        trouble: what held them last; empty if nothing did.
        since: when it became that one (monotonic, s).
        stepped: when the last step was.
        rest: where the follower has stayed, and since when.
        leader_at: where the leader was when they were coupled; None in the mode velocity.
        follower_at: where the follower was then.
        leader: where the leader was in the last step.
        sent: what the follower was sent last.
        lag: metres and radians between what was sent and what the leader wants.
        jaw: that the leader's gripper leads, or waits for; None where there is none.
    """

    phase: Phase = Phase.HELD
    reason: str = ""
    trouble: str = ""
    since: float = 0.0
    stepped: float | None = None
    rest: Heard[Pose] | None = None
    leader_at: Pose | None = None
    follower_at: Pose | None = None
    leader: Pose | None = None
    sent: Pose | Twist | None = None
    lag: tuple[float, float] = (0.0, 0.0)
    jaw: jaws.Jaw | None = None


def step(settings: TeleopSettings, before: Coupled, heard: Inputs) -> tuple[Coupled, Commands]:
    """Return how they are after what was heard, and what to send. Raises nothing, whatever is heard."""
    rest = rested(before.rest, heard.follower.pose)
    now = replace(before, stepped=heard.now, rest=rest)
    event, reason = _judged(settings, before, heard, now)
    phase = TRANSITIONS[before.phase][event]
    if phase is not before.phase:
        now = replace(now, phase=phase, since=heard.now)
    if event is Event.TROUBLE:
        now = replace(now, trouble=reason)
    elif phase is Phase.HELD:
        reason = f"let the pedal go first; before: {now.trouble or 'nothing was coupled'}"
    now = replace(now, reason=reason)
    if phase is not Phase.FOLLOWING:
        now = replace(
            now,
            leader_at=None,
            follower_at=None,
            leader=None,
            sent=None,
            lag=(0.0, 0.0),
            jaw=None,
        )
        return now, _uncoupled(settings, before.phase, phase)
    if before.phase is not Phase.FOLLOWING:
        now = _begun(settings, now, heard)
    return _followed(settings, before, now, heard)


def _uncoupled(settings: TeleopSettings, before: Phase, phase: Phase) -> Commands:
    """Return what is sent while they are not coupled."""
    left, held = before is Phase.FOLLOWING, phase is Phase.HELD
    return Commands(
        hold_follower=left,
        hold_leader=held and left,
        free_leader=settings.free_leader and phase is Phase.RELEASED and before is not phase,
        leader=None if settings.force is None or held else NO_FORCE,
        follower=STANDING if left and settings.mode != "position" else None,
    )


NO_FORCE: Final = Wrench(coupling.ZERO, coupling.ZERO)
STANDING: Final = Twist(coupling.ZERO, coupling.ZERO)


# ---------------------------------------------------------------------------------------- what was heard


def _judged(
    settings: TeleopSettings, before: Coupled, heard: Inputs, now: Coupled
) -> tuple[Event, str]:
    trouble = _trouble(settings, before, heard)
    if trouble:
        return Event.TROUBLE, trouble
    let_go = _let_go(settings, heard)
    if let_go:
        return Event.LET_GO, let_go
    if before.phase is Phase.FOLLOWING:
        return Event.READY, ""
    waits = _waits(settings, heard, now)
    return (Event.WANTED, waits) if waits else (Event.READY, "")


def _trouble(settings: TeleopSettings, before: Coupled, heard: Inputs) -> str:
    """Return why they cannot be coupled; empty if they can."""
    for name, side, needed, timeout in _needed(settings, heard):
        found = _of_side(side, needed, heard.now, timeout)
        if found:
            return f"{name} {found}"
    silent = _silent(settings, heard)
    if silent:
        return silent
    if before.stepped is not None and heard.now - before.stepped > settings.timeout:
        return f"this program stood still for {heard.now - before.stepped:.2f} s"
    if before.phase is not Phase.FOLLOWING:
        return ""
    if heard.follower.refusal:
        return f"{settings.follower} refused: {heard.follower.refusal}"
    if settings.gripper is not None and heard.jaw.refusal:
        return f"{settings.follower}/{settings.gripper.follower} refused: {heard.jaw.refusal}"
    if heard.leader.refusal and settings.force is not None:
        return f"{settings.leader} refused: {heard.leader.refusal}"
    return (
        _turned_axes(settings, before, heard)
        or _jumped(settings, before, heard)
        or _left_behind(settings, before, heard)
    )


def _needed(settings: TeleopSettings, heard: Inputs) -> Iterator[tuple[str, Side, str, float]]:
    """Yield each side by name, what is needed of it, and how old (s) that may be."""
    leads = "twist" if settings.mode == "velocity" else "pose"
    yield settings.leader, heard.leader, leads, settings.timeout
    yield settings.follower, heard.follower, "pose", settings.timeout
    gripper = settings.gripper
    if gripper is not None:
        name = f"{settings.leader}/{gripper.leader}"
        yield name, heard.leader_gripper, "joint", gripper.timeout
        yield f"{settings.follower}/{gripper.follower}", heard.jaw, "joint", gripper.timeout


_NEEDS: Final = {
    "pose": ("measured_cp", "no pose"),
    "twist": ("measured_cv", "no velocity"),
    "joint": ("measured_js", "no position of one joint"),
}
"""What is heard, and what it is where it cannot be used."""


def _of_side(side: Side, needed: str, now: float, timeout: float) -> str:
    if side.lost:
        return f"is lost: {side.lost}"
    if side.status is not None:
        if side.status.state is not OperatingState.ENABLED:
            return f"is {side.status.state}" + (
                f": {side.status.cause}" if side.status.cause else ""
            )
        if not side.status.is_homed:
            return "is not homed"
    newest: Heard[Any] | None = getattr(side, needed)
    topic, wrong = _NEEDS[needed]
    if newest is None:
        return f"has told no valid {topic} yet"
    if now - newest.since > timeout:
        return f"has not been heard for more than {timeout:g} s"
    return "" if _can_be_used(newest.value) else f"tells what is {wrong}"


def _can_be_used(value: Pose | Twist | JointState) -> bool:
    if isinstance(value, Pose):
        return coupling.is_pose(value)
    if isinstance(value, JointState):
        return jaws.opening_of(value) is not None
    return coupling.is_measured(value.vector)


def _turned_axes(settings: TeleopSettings, before: Coupled, heard: Inputs) -> str:
    """Return which side tells its pose in other axes than when they were coupled; empty if none does."""
    for name, pose, at in (
        (settings.leader, heard.leader.pose, before.leader_at),
        (settings.follower, heard.follower.pose, before.follower_at),
    ):
        if pose is not None and at is not None and pose.value.frame_id != at.frame_id:
            return (
                f"{name} tells its pose in the axes of {pose.value.frame_id!r}, "
                f"and before of {at.frame_id!r}"
            )
    return ""


def _jumped(settings: TeleopSettings, before: Coupled, heard: Inputs) -> str:
    if before.leader is None or heard.leader.pose is None:
        return ""
    way, angle = coupling.distances(heard.leader.pose.value, before.leader)
    if way <= settings.limits.jump and angle <= settings.limits.turn_jump:
        return ""
    return f"{settings.leader} jumped by {_told(way, angle)}"


def _left_behind(settings: TeleopSettings, before: Coupled, heard: Inputs) -> str:
    limits = settings.limits
    if before.lag[0] > limits.lag or before.lag[1] > limits.turn_lag:
        return f"{settings.leader} is {_told(*before.lag)} ahead of what the speed limits allow"
    if isinstance(before.sent, Pose) and heard.follower.pose is not None:
        way, angle = coupling.distances(heard.follower.pose.value, before.sent)
        if way > limits.lag or angle > limits.turn_lag:
            return f"{settings.follower} is {_told(way, angle)} from where it was sent"
    return ""


def _told(way: float, angle: float) -> str:
    return f"{1e3 * way:.0f} mm and {math.degrees(angle):.0f}°"


def _silent(settings: TeleopSettings, heard: Inputs) -> str:
    """Return which pedal is not heard; empty if all are.

    What it says when it is heard again may be as old as the silence, or a foot that stayed on it.
    """
    if heard.doubt:
        return heard.doubt
    for pedal, now in ((settings.engage, heard.engage), (settings.clutch, heard.clutch)):
        if pedal is not None and is_pressed(pedal, now, heard.now) is None:
            return f"{pedal.told} is not heard"
    return ""


def _let_go(settings: TeleopSettings, heard: Inputs) -> str:
    """Return which pedal uncouples them, and why; empty if none does."""
    for pedal, now, couples in (
        (settings.engage, heard.engage, True),
        (settings.clutch, heard.clutch, False),
    ):
        if pedal is None:
            continue
        pressed = is_pressed(pedal, now, heard.now)
        if pressed is not couples:
            return f"{pedal.told} is {'pressed' if pressed else 'not pressed'}"
    return ""


def is_pressed(pedal: PedalSettings, heard: Heard[bool] | None, now: float) -> bool | None:
    """Return whether a pedal is pressed; None if that is not known, or not any more."""
    if heard is None or (pedal.topic and pedal.repeats and now - heard.since > pedal.timeout):
        return None
    return heard.value


def rested(rest: Heard[Pose] | None, pose: Heard[Pose] | None) -> Heard[Pose] | None:
    """Return where the follower has stayed, and since when; None if it tells no pose."""
    if pose is None or not coupling.is_pose(pose.value):
        return None
    if rest is not None:
        way, angle = coupling.distances(pose.value, rest.value)
        if way <= STILL[0] and angle <= STILL[1]:
            return rest
    return pose


def stands(rest: Heard[Pose] | None, pose: Heard[Pose] | None) -> bool:
    """Return whether it has told for long enough that it is there; silence tells nothing."""
    return rest is not None and pose is not None and pose.since - rest.since >= STILL_TIME


def _waits(settings: TeleopSettings, heard: Inputs, now: Coupled) -> str:
    """Return what they wait for before they are coupled; empty if for nothing."""
    if not stands(now.rest, heard.follower.pose):
        return f"{settings.follower} still moves"
    if settings.orientation == "aligned":
        assert heard.leader.pose is not None, "no trouble"
        assert heard.follower.pose is not None, "no trouble"
        angle = coupling.misalignment(settings, heard.leader.pose.value, heard.follower.pose.value)
        if angle > settings.tolerance:
            return f"turn {settings.leader} by {math.degrees(angle):.0f}° to {settings.follower}"
    return ""


# --------------------------------------------------------------------------------------- what is sent


def _begun(settings: TeleopSettings, now: Coupled, heard: Inputs) -> Coupled:
    """Note where both are: from here the follower goes, and to here it is sent first."""
    assert heard.follower.pose is not None, "no trouble"
    start, setpoint = heard.follower.pose.value, heard.follower.setpoint
    if (
        setpoint is not None
        and heard.now - setpoint.since <= settings.timeout
        and setpoint.value.frame_id == start.frame_id
        and coupling.is_pose(setpoint.value)
    ):
        way, angle = coupling.distances(setpoint.value, start)
        if way <= AT_SETPOINT[0] and angle <= AT_SETPOINT[1]:
            start = setpoint.value
    leader = _leader_pose(settings, heard)
    jaw = _jaw_begun(settings, heard)
    return replace(now, leader_at=leader, follower_at=start, leader=leader, jaw=jaw)


def _jaw_begun(settings: TeleopSettings, heard: Inputs) -> jaws.Jaw | None:
    """Return the jaw where it was sent last: what it holds keeps its fingers from there."""
    gripper, setpoint = settings.gripper, heard.jaw.joint_setpoint
    if gripper is None:
        return None
    sent = None
    if setpoint is not None and heard.now - setpoint.since <= gripper.timeout:
        sent = jaws.opening_of(setpoint.value)
    at = _opening(heard.jaw) if sent is None else sent
    return jaws.begun(gripper, _opening(heard.leader_gripper), at)


def _opening(side: Side) -> float:
    assert side.joint is not None, "no trouble"
    opening = jaws.opening_of(side.joint.value)
    assert opening is not None, "no trouble"
    return opening


def _leader_pose(settings: TeleopSettings, heard: Inputs) -> Pose | None:
    """Return where the leader is; None where that does not matter."""
    if settings.mode == "velocity" or heard.leader.pose is None:
        return None
    return heard.leader.pose.value


def _followed(
    settings: TeleopSettings, before: Coupled, now: Coupled, heard: Inputs
) -> tuple[Coupled, Commands]:
    dt = _since_last(settings, before, heard)
    sent: Pose | Twist
    if settings.mode == "position":
        sent, lag = _pose_sent(settings, now, heard, dt)
        now = replace(now, lag=lag)
    else:
        last = now.sent if isinstance(now.sent, Twist) else STANDING
        wanted = _wanted(settings, now, heard)
        sent = coupling.approach_twist(
            settings.limits, last, wanted, dt if now.sent is not None else 0.0
        )
    jaw = now.jaw
    if settings.gripper is not None and jaw is not None:
        jaw = jaws.led(settings.gripper, jaw, _opening(heard.leader_gripper), dt)
    now = replace(now, leader=_leader_pose(settings, heard), sent=sent, jaw=jaw)
    return now, Commands(
        follower=sent,
        leader=_force(settings, now, heard),
        jaw=jaw.at if jaw is not None and jaw.is_led else None,
    )


def _since_last(settings: TeleopSettings, before: Coupled, heard: Inputs) -> float:
    """Return how long, in s, the follower may have moved; after a late step not as long as that was."""
    if before.stepped is None:
        return 0.0
    return min(max(heard.now - before.stepped, 0.0), 2.0 / settings.rate)


def _pose_sent(
    settings: TeleopSettings, now: Coupled, heard: Inputs, dt: float
) -> tuple[Pose, tuple[float, float]]:
    assert heard.leader.pose is not None, "no trouble"
    assert now.leader_at is not None
    assert now.follower_at is not None
    goal = coupling.goal_of(settings, heard.leader.pose.value, now.leader_at, now.follower_at)
    if not isinstance(now.sent, Pose):
        return goal, (0.0, 0.0)
    sent = coupling.approach(settings.limits, now.sent, goal, dt)
    return sent, coupling.distances(goal, sent)


def _wanted(settings: TeleopSettings, now: Coupled, heard: Inputs) -> Twist:
    if settings.mode == "velocity":
        assert heard.leader.twist is not None, "no trouble"
        return coupling.wanted_by_speed(settings, heard.leader.twist.value)
    assert heard.leader.pose is not None, "no trouble"
    assert now.leader_at is not None
    return coupling.wanted_by_way(settings, heard.leader.pose.value, now.leader_at)


def _force(settings: TeleopSettings, now: Coupled, heard: Inputs) -> Wrench | None:
    force, wrench = settings.force, heard.follower.wrench
    if force is None:
        return None
    if (
        wrench is None
        or heard.now - wrench.since > settings.timeout
        or not coupling.is_measured(wrench.value.vector)
    ):
        return NO_FORCE
    assert heard.follower.pose is not None, "no trouble"
    share = min(1.0, (heard.now - now.since) / force.ramp)
    return coupling.reflected(settings, force, wrench.value, heard.follower.pose.value, share)
