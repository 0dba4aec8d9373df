"""Limits hold: what is asked to be faster than it may, or to pass the end of its range, does neither."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from crtk_drivers.device import JointLimits
from crtk_drivers.labs.bench.acquisition import BUSY, Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import ROOM, SMALL_ANGLE, SMALL_SPEED, SMALL_WAY, Bed
from crtk_drivers.labs.bench.signals import resolution
from crtk_drivers.labs.bench.stops import motion
from crtk_drivers.labs.bench.trace import JointTrack, Trace
from crtk_drivers.labs.verdicts.estimates import exact, in_percent, share, within
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Comparison,
    Findings,
    Measurement,
    Plot,
    Quantity,
    Worse,
)
from crtk_drivers.samples import Vector, vector

TOO_FAST: Final = 1.2
"""Times the velocity limit that a stream asks for."""

AT_SPEED: Final = 0.4
"""Seconds for which it does."""

SPEEDING_UP: Final = 0.8
"""Share of the acceleration limit with which it gets there."""

BEFORE_END: Final = 1.0
"""Times the way of a small motion from which a joint is sent to the end of its range."""

PAST_END: Final = 0.5
"""Times that way by which it is sent past the end."""

SETTLES: Final = 0.3

SLOW: Final = 0.5
"""Share of its limit below which a joint that was asked to be too fast, and refused nothing, did not go."""

FAR: Final = 0.6
"""Share of its way to the end of its range that a joint may have left, else it did not go there."""

STAYED: Final = "it did not go where it was sent, and refused nothing"

WINDOWS: Final = (0.08, 0.25, 0.4)
"""Seconds over which a speed is taken."""

BEYOND: Final = 1e-3
"""rad (m): by which a joint may be past the end of its range, where a step of its encoder is less."""

SPEED = Quantity.at_most("limits.speed.peak", "greatest speed over its limit", "", 0.02)
SHORT = Quantity.told("limits.speed.short", "greatest speed in 80 ms over its limit", "", 0.03)
END = Quantity.at_most("limits.range.beyond", "way past the end of the range", "mrad or mm", 0.2)
REFUSED = Quantity(
    "limits.commands.refused",
    "commands refused meanwhile",
    "%",
    Comparison.TOLD,
    Worse.EITHER,
    20.0,
)


# -------------------------------------------------------------------------------------------- acquisition


def _beyond_limits(bed: Bed) -> None:
    bed.enable()
    home = bed.setpoint
    tries: list[dict[str, Any]] = []
    left_out: dict[str, dict[str, str]] = {"fast": {}, "end": {}}
    commands = [name for name in ("servo_jp", "servo_jv") if bed.offers(name)]
    for joint, name in enumerate(bed.about.capabilities.joints):
        for kind, try_joint in (("fast", _too_fast), ("end", _past_end)):
            if why := try_joint(bed, home, joint, commands, tries):
                left_out[kind][name] = why
    bed.note(tries=tries, left_out=left_out, max_step=bed.about.max_step)
    bed.disable()


def _try(
    bed: Bed, kind: str, joint: int, command: str, speed: Vector, seconds: float, way: float
) -> dict[str, Any]:
    """Stream to one joint from where it is set, whatever is refused, and let it come to rest.

    `way` is how far it may go, and `speed` (n,) that of all joints.
    """
    tried = f"{kind} {joint} {command}"
    value = motion(command, bed.setpoint, speed, _ramp(bed, joint, float(np.abs(speed).max())))
    bed.mark(f"begin {tried}")
    sent, refused = bed.insist(command, value, seconds)
    bed.rest(bed.about.silence + SETTLES)
    bed.mark(f"end {tried}")
    return {
        "kind": kind,
        "joint": joint,
        "command": command,
        "sent": sent,
        "refused": refused,
        "way": way,
        "sign": float(np.sign(speed[joint])),
    }


def _ramp(bed: Bed, joint: int, speed: float) -> float:
    """Return the seconds in which one joint gets to a speed."""
    return speed / (SPEEDING_UP * bed.about.capabilities.limits[joint].acceleration)


def _along(size: int, joint: int, value: float) -> Vector:
    found = np.zeros(size)
    found[joint] = value
    return vector(found)


def _too_fast(
    bed: Bed, home: Vector, joint: int, commands: list[str], tries: list[dict[str, Any]]
) -> str:
    """Ask one joint to be too fast, where there is room for that; return why that could not be done."""
    own = bed.about.capabilities
    limit = own.limits[joint]
    speed = TOO_FAST * limit.velocity
    seconds = _ramp(bed, joint, speed) + AT_SPEED
    lag = 0.0 if own.following is None else own.following.lag
    stopping = speed * (bed.about.silence + lag) + 0.5 * speed**2 / limit.acceleration
    way = speed * (seconds - 0.5 * _ramp(bed, joint, speed)) + stopping
    up, down = limit.upper - home[joint], home[joint] - limit.lower
    if way > ROOM * (up + down):
        return f"too little room: that takes {way:.2g} of a range of {up + down:.2g}"
    sign = 1.0 if up >= down else -1.0
    # As much as there is too little room from where it is, it begins further back.
    back = max(0.0, way + 0.5 * (1.0 - ROOM) * (up + down) - max(up, down))
    begin = vector(home - _along(home.size, joint, sign * back))
    for place in (begin, vector(begin + _along(home.size, joint, sign * way))):
        if not bed.is_free(place):
            return "its tool would leave its space"
    for command in commands:
        bed.move_to(begin)
        asked = _along(home.size, joint, sign * speed)
        tries.append(_try(bed, "fast", joint, command, asked, seconds, way))
    bed.move_to(home)
    return ""


def _past_end(
    bed: Bed, home: Vector, joint: int, commands: list[str], tries: list[dict[str, Any]]
) -> str:
    """Send one joint slowly past the nearer end of its range; return why that could not be done."""
    limit = bed.about.capabilities.limits[joint]
    if not (math.isfinite(limit.lower) and math.isfinite(limit.upper)):
        return "its range has no end"
    sign = 1.0 if limit.upper - home[joint] <= home[joint] - limit.lower else -1.0
    end = limit.upper if sign > 0.0 else limit.lower
    small = SMALL_WAY if bed.slides[joint] > 0.5 else SMALL_ANGLE
    way = min(BEFORE_END * small, 0.25 * (limit.upper - limit.lower))
    begin, goal = home.copy(), home.copy()
    begin[joint], goal[joint] = end - sign * way, end
    if not bed.is_free(vector(goal)):
        return "its tool would leave its space"
    speed = min(SMALL_SPEED * limit.velocity, way / 0.3)
    seconds = way * (1.0 + PAST_END) / speed + _ramp(bed, joint, speed)
    for command in commands:
        bed.move_to(vector(begin))
        asked = _along(home.size, joint, sign * speed)
        tries.append(_try(bed, "end", joint, command, asked, seconds, way))
    bed.move_to(home)
    return ""


BEYOND_LIMITS: Final = Acquisition(
    "limits",
    "Asks one joint after the other for 1.2 times its speed, and to go past the nearer end of its range.",
    Safety.LARGE,
    _beyond_limits,
    ("servo_jp", "move_jp", "measured_js"),
    suite=Suite.FULL,
)


# ----------------------------------------------------------------------------------------------- analysis


def peak_speed(track: JointTrack, column: int, window: float, allowed: float = 0.0) -> float:
    """Return the greatest speed of one joint, each taken over `window` s; NaN of too few samples.

    Args:
        track: of the joints, by the time of acquisition.
        column: which joint.
        window: in s.
        allowed: rad (m) that it may go in each window without that counting.
    """
    at, position = track.at, track.position[:, column]
    later = np.searchsorted(at, at + window)
    whole = np.flatnonzero(later < at.size)
    if not whole.size:
        return math.nan
    ways = np.abs(position[later[whole]] - position[whole]) - allowed
    return float((ways / (at[later[whole]] - at[whole])).max())


def _parts(trace: Trace, kind: str) -> Iterator[tuple[dict[str, Any], JointTrack]]:
    joints = trace.joints.by_stamp
    for each in trace.notes["tries"]:
        if each["kind"] == kind:
            tried = f"{kind} {each['joint']} {each['command']}"
            yield each, joints.between(trace.mark(f"begin {tried}"), trace.mark(f"end {tried}"))


def _hold(trace: Trace, subject: Subject) -> Findings:
    steps = resolution(trace.joints.position)
    gaps = [
        doubt
        for kind in ("fast", "end")
        for _, part in _parts(trace, kind)
        for doubt in (*subject.gaps(part.at), *(subject.uneven(part.at) if kind == "fast" else ()))
    ]
    tries = trace.notes["tries"]
    sent, refused = (sum(each[what] for each in tries) for what in ("sent", "refused"))
    found = [*_speeds(trace, subject, steps), _end(trace, subject, steps)]
    if sent:
        found.append(subject.measured(REFUSED, in_percent(share(refused, sent))))
    return Findings(
        tuple(found), doubts=(*subject.too_busy(BUSY), *gaps[:1]), plots=_plots(trace, subject)
    )


def _speeds(trace: Trace, subject: Subject, steps: Vector) -> list[Measurement]:
    """Of a stream of positions the driver lets through `max_step` at once: no window may hold more beside."""
    bound = Bound(1.05, "its velocity limit, and a twentieth; `max_step` of a stream is left out")
    peaks: list[tuple[float, float, str]] = []
    short: list[tuple[float, str]] = []
    for each, part in _parts(trace, "fast"):
        joint, limit = each["joint"], subject.limits[each["joint"]].velocity
        name = f"{subject.joints[joint]}, {each['command']}"
        fastest = peak_speed(part, joint, WINDOWS[0]) / limit
        if not (fastest > SLOW or (each["refused"] and math.isfinite(fastest))):
            continue
        short.append((fastest, name))
        allowed = trace.notes["max_step"] * limit if each["command"] == "servo_jp" else 0.0
        for window in WINDOWS:
            peak = peak_speed(part, joint, window, allowed) / limit
            if math.isfinite(peak):
                peaks.append((peak, float(steps[joint]) / (window * limit), name))
    why = _left_out(trace, "fast")
    if not peaks:
        return [subject.measured(SPEED, None, bound, why=why or STAYED)]
    value, doubt, name = max(peaks)
    fastest, of_short = max(short)
    return [
        subject.measured(SPEED, within(value, doubt, len(short)), bound, part=name, why=why),
        subject.measured(SHORT, exact(fastest, len(short)), part=of_short),
    ]


def _left_out(trace: Trace, kind: str) -> str:
    """Return which joints were not tried, and why."""
    return "; ".join(f"{name}: {why}" for name, why in trace.notes["left_out"][kind].items())


def _end(trace: Trace, subject: Subject, steps: Vector) -> Measurement:
    found: list[tuple[float, float, str]] = []
    for each, part in _parts(trace, "end"):
        joint, sign = each["joint"], each["sign"]
        limit: JointLimits = subject.limits[joint]
        if part.at.size < 20:
            continue
        end = limit.upper if sign > 0.0 else limit.lower
        beyond = float((sign * (part.position[:, joint] - end)).max())
        if beyond < -FAR * each["way"]:
            continue
        allowed = max(2.0 * float(steps[joint]), BEYOND)
        name = f"{subject.joints[joint]}, {each['command']}"
        found.append((beyond / allowed, allowed, name))
    if not found:
        return subject.measured(END, None, None, why=_left_out(trace, "end") or STAYED)
    ratio, allowed, name = max(found)
    bound = Bound(1e3 * allowed, "two steps of its encoder, or 1 mrad")
    return subject.measured(
        END, exact(1e3 * ratio * allowed, len(found)), bound, part=name, why=_left_out(trace, "end")
    )


def _plots(trace: Trace, subject: Subject) -> tuple[Plot, ...]:
    found = []
    for kind, title in (("fast", "Sent too fast"), ("end", "Sent past the end of its range")):
        lines = [
            (
                f"{subject.joints[each['joint']]} {each['command']}",
                part.at - part.at[0],
                part.position[:, each["joint"]] - part.position[0, each["joint"]],
            )
            for each, part in _parts(trace, kind)
            if part.at.size
        ]
        if lines:
            found.append(Plot.of(title, "time, s", "rad or m", *lines))
    return tuple(found)


TESTS: Final = (
    BenchTest("S9", "limits hold", "limits", BEYOND_LIMITS, _hold, (SPEED, SHORT, END, REFUSED)),
)
