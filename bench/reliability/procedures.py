"""How a cell is run and judged: one procedure for each thing that may have to follow."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from bench.reliability.activities import MOVES, STANDING
from bench.reliability.rig import PATIENCE, SLACK, BrokenPromiseError, Log, Rig
from bench.reliability.stamps import Look
from bench.reliability.table import Cell, Follows, Way
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.motion.stopping import still_speeds

CALM = 0.15
"""Seconds in which something that moves by itself would have begun to, with the link back."""
GOING_ON = 0.4
"""Seconds for which an activity must go on through a fault that it survives."""


@dataclass
class Result:
    """What was measured in a cell. Times in s from the beginning of the fault; None: not measured.

    Attributes:
        state, detail: that was announced.
        told: until it was announced.
        stood: until all joints stood.
        way: how far the joint that went farthest went, rad (m).
    """

    state: str = ""
    detail: str = ""
    told: float | None = None
    stood: float | None = None
    way: float | None = None
    notes: dict[str, float] = field(default_factory=dict)


def run(rig: Rig, cell: Cell) -> Result:
    """Run a cell.

    Raises:
        BrokenPromiseError: with what did not follow.
    """
    rig.ready()
    try:
        return PROCEDURES[cell.way.follows](rig, cell.way, cell.activity)
    finally:
        rig.stop_activity()
        rig.end_fault()


def _slack(rig: Rig) -> float:
    return SLACK if rig.patient else SLACK / 2.0


def _stops(rig: Rig, way: Way, activity: str) -> Result:
    """The state is announced with its reason, the joints stand, nothing moves until a client asks."""
    rig.begin_activity(activity)
    began = rig.begin_fault(way)
    result = _announced(rig, way, began)
    if way.freezes:
        rig.end_fault()
        began = time.monotonic()
    rest = _stood(rig, way, began, result)
    _ended(rig)
    rig.end_fault()
    rig.until(lambda: rig.connected, PATIENCE, "it is connected again")
    rig.run(CALM)
    _stands_at(rig, rest, "the link is back and nobody has asked for anything")
    rig.require(rig.status.state != "ENABLED", "it is ENABLED though nobody has enabled it")
    _enables(rig)
    return result


def _announced(rig: Rig, way: Way, began: float) -> Result:
    """Wait until one of the states has been announced with the words of its reason."""

    def found() -> bool:
        for at, status in rig.log.announced:
            if at >= began and status.state in way.states and way.detail in status.detail:
                result.state, result.detail = str(status.state), status.detail
                result.told = at - began
                return True
        return False

    result = Result()
    what = f"{' or '.join(way.states)} ({way.detail or 'with a reason'})"
    rig.until(found, way.within + _slack(rig), what)
    rig.require(bool(result.detail), f"{result.state} has no reason")
    return result


def _stood(rig: Rig, way: Way, began: float, result: Result) -> np.ndarray:
    """Wait until all joints stand; measure when they came to, and how far they went."""
    remaining = began + way.stands + _slack(rig) - time.monotonic()
    rig.look()
    rest = rig.until_still(max(remaining, 0.3))
    looks = [look for look in rig.looks if look.at >= began]
    away = [np.abs(look.joints - rest).max(initial=0.0) for look in looks]
    moving = [look.at for look, far in zip(looks, away, strict=True) if far > rig.tolerance]
    result.stood = max(moving, default=began) - began
    start = looks[0].joints
    result.way = max(float(np.abs(look.joints - start).max(initial=0.0)) for look in looks)
    rig.require(result.way <= way.far, f"a joint went on by {result.way:.4f}, of {way.far:g}")
    return rest


def _ended(rig: Rig) -> None:
    """Require that no move is under way, and that one that was aborted has a reason."""
    rig.require(not rig.status.is_busy, "it is still busy")
    move = rig.activity.move if rig.activity else None
    if move is not None:
        rig.require(not move.is_busy(), "the move has not ended")
        rig.require(bool(move.reason) or str(move.outcome) != "aborted", "aborted without a reason")


def _far(rig: Rig, start: np.ndarray) -> float:
    """Return how far from there the joint is that is farthest, rad (m)."""
    return float(np.abs(rig.look().joints - start).max(initial=0.0))


def _stands_at(rig: Rig, rest: np.ndarray, when: str) -> None:
    far = _far(rig, rest)
    rig.require(far <= 2.0 * rig.tolerance, f"{when}, but a joint moved by {far:.4f}")


def _enables(rig: Rig) -> None:
    rig.stop_activity()
    # A joint without torque may still coast, slower than what counts as moving.
    rest, moves = rig.look().joints, rig.enable_moves
    rig.enable()
    rig.run(0.1)
    if not moves:
        _stands_at(rig, rest, "it was only enabled")
    rig.be_homed()
    if "move_jp" in rig.engine.commands:
        goal = np.array(rig.arm.setpoint_jp(age=0))
        goal[0] -= 5.0 * rig.tolerance
        move = rig.arm.move_jp(goal)
        rig.until(lambda: not move.is_busy(), PATIENCE, "a move ends")
        rig.require(str(move.outcome) == "reached", f"a move is {move.outcome}: {move.reason}")


def _goes_on(rig: Rig, way: Way, activity: str) -> Result:
    """The state stays ENABLED, and what the driver does goes on."""
    rig.begin_activity(activity)
    rig.log.announced.clear()
    before = rig.look().joints
    began = rig.begin_fault(way)
    if activity in MOVES and rig.activity is not None:
        move = rig.activity.move
        rig.until(lambda: not move.is_busy(), PATIENCE, "the move ends")
        rig.require(str(move.outcome) == "reached", f"the move is {move.outcome}: {move.reason}")
        rig.require(_far(rig, before) > 5.0 * rig.tolerance, "it has not moved any more")
    else:
        rig.run(GOING_ON)
        if activity not in STANDING:  # later than what was on its way has been carried out
            there = rig.look().joints
            moved = 5.0 * rig.tolerance
            rig.until(lambda: _far(rig, there) > moved, _slack(rig), "it goes on moving")
    left = [status for _, status in rig.log.announced if status.state != "ENABLED"]
    rig.require(not left, f"it left ENABLED: {left[:1]}")
    if activity in STANDING:
        far = _far(rig, before)
        rig.require(far <= 2.0 * rig.tolerance, f"it moved by {far:.4f} at rest")
    rig.stop_activity()
    if rig.moves_joints:
        with contextlib.suppress(CommandRefused):
            rig.arm.hold()
    rig.until_still()
    rig.end_fault()
    return Result(state="ENABLED", told=None, way=None, notes={"seconds": time.monotonic() - began})


def _holds(rig: Rig, way: Way, activity: str) -> Result:
    """A stream that stops is stopped, and the state is as configured."""
    rig.begin_activity(activity)
    rig.pause_stream()
    began = time.monotonic()
    result = Result(state="ENABLED")
    rest = _stood(rig, way, began, result)
    rig.run(CALM)
    _stands_at(rig, rest, "the stream is over")
    rig.require(str(rig.status.state) in way.states, f"it is {rig.status}")
    return result


def _starts_later(rig: Rig, way: Way, activity: str) -> Result:
    """It says why it cannot connect, lives on, and connects later: DISABLED."""
    rig.close()
    rig.open(start=False)
    rest = rig.look().joints
    try:
        began = rig.begin_fault(way)
        rig.driver.start()
        result = _announced(rig, way, began)
        rig.require(not rig.engine.connected, "it is connected")
        told = f"{rig.engine.where}: {result.detail}"
        rig.require(rig.named in told, f"{told!r} does not name {rig.named}")
    finally:
        rig.end_fault()
    rig.until(lambda: rig.connected, PATIENCE, "it connects later")
    rig.run(CALM)
    rig.require(rig.status.state in ("DISABLED", "FAULT"), f"it is {rig.status}")
    _stands_at(rig, rest, "it has only connected")
    _enables(rig)
    return result


def _restarted(rig: Rig, way: Way, activity: str) -> Result:
    """Closed in motion, the arm stands; a new driver is DISABLED and nothing moves."""
    rig.begin_activity(activity)
    began = time.monotonic()
    is_silent = rig.close_watched()
    closed = rig.look()
    result = Result()
    rest = _stood(rig, way, began, result)
    _has_said(rig, is_silent, closed, rest)
    rig.require(rig.powered() in (None, rig.keeps_power), f"power after close: {rig.powered()}")
    return _reopened(rig, rest, result)


def _reopened(rig: Rig, rest: np.ndarray, result: Result) -> Result:
    """Another driver is DISABLED and moves nothing until a client asks for it."""
    rig.open()
    rig.run(CALM)
    rig.require(rig.status.state == "DISABLED", f"it is {rig.status}")
    result.state, result.detail = str(rig.status.state), rig.status.detail
    _stands_at(rig, rest, "another driver has only connected")
    _enables(rig)
    return result


def _kept_out(rig: Rig, way: Way, activity: str) -> Result:
    """A second driver is refused with a reason; the first one goes on."""
    rig.begin_activity(activity)
    rig.log.announced.clear()
    began = time.monotonic()
    with rig.second_host() as second:
        log = Log()
        second.engine.add_observer(log)
        result = Result()

        def refused() -> bool:
            status = second.engine.status
            if second.engine.connected and second.engine.transition_ended:
                with contextlib.suppress(CommandRefused):
                    second.engine.state_command("enable")
            told = [status.detail, *map(str, log.refused)]
            result.state = str(status.state)
            result.detail = next((text for text in told if way.detail in text), "")
            return bool(result.detail)

        rig.until(refused, PATIENCE, f"the second driver is refused ({way.detail})")
        result.told = time.monotonic() - began
        rig.require(result.state != "ENABLED", "the second driver is ENABLED")
    left = [status for _, status in rig.log.announced if status.state != "ENABLED"]
    rig.require(not left, f"the first one left ENABLED: {left[:1]}")
    rig.stop_activity()
    return result


def _start(options: str, activity: str) -> subprocess.Popen[bytes]:
    """Start a driver in a process of its own."""
    command = [sys.executable, "-m", "bench.reliability.victim", options, activity]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL)


def _outlived(rig: Rig, way: Way, activity: str) -> Result:
    """The hardware stops by itself when the driver's process is killed or frozen."""
    rig.close()
    options = {
        "plugin": rig.plugin.name,
        "config": json.loads(rig.config.model_dump_json(exclude_unset=True)),
        "plan": asdict(rig.plan),
    }
    result = Result()
    with _start(json.dumps(options), activity) as victim:
        try:
            rig.looks.clear()
            start = rig.look().joints

            def moves() -> bool:
                if victim.poll() is not None:
                    raise BrokenPromiseError(f"the driver's process ended: {victim.returncode}")
                return bool(np.abs(rig.joints() - start).max() > 10.0 * rig.tolerance)

            rig.until(moves, 2.0 * PATIENCE, "it moves")
            began = time.monotonic()
            victim.send_signal(way.parameters["signal"])
            rest = _stood(rig, way, began, result)
        finally:
            victim.kill()
    return _reopened(rig, rest, result)


def _obeys(rig: Rig, way: Way, activity: str) -> Result:
    """A stop is carried out though one of its messages is not; what cannot be confirmed is reported."""
    rig.begin_activity(activity)
    began = rig.begin_fault(way)
    rig.stop_activity()
    result = Result()
    is_lost = is_silent = False
    try:
        if way.action == "close":
            is_silent = rig.close_watched()
        elif way.action == "hold":
            rig.arm.hold()
        else:
            rig.engine.state_command(way.action)
    except CommandRefused as refusal:
        is_lost = way.may_lose_link and refusal.reason is Reason.NOT_CONNECTED
        if not is_lost:
            raise
    then = rig.look()
    rest = _stood(rig, way, began, result)
    if way.action == "close":
        _has_said(rig, is_silent, then, rest)
        rig.end_fault()
        rig.open()
    else:
        rig.until(lambda: rig.engine.transition_ended, PATIENCE, f"{way.action} ends")
        stood = time.monotonic()
        rig.until(lambda: _is_told(rig, stood), PATIENCE, "a sample comes, or it is FAULT")
        wanted = {"hold": "ENABLED", "pause": "PAUSED", "disable": "DISABLED"}[way.action]
        state, detail = rig.status.state, rig.status.detail
        fault = state == "FAULT" or (way.may_lose_link and state == "DISABLED")
        told = (state == wanted and not is_lost) or (fault and bool(detail))
        rig.require(told, f"after {way.action} it is {state} ({detail})")
        result.state, result.detail = str(state), detail
    rig.run(CALM)
    _stands_at(rig, rest, f"{way.action} has been carried out")
    rig.end_fault()
    _enables(rig)
    return result


def _has_said(rig: Rig, is_silent: bool, closed: Look, rest: np.ndarray) -> None:
    """Require that `close()` has raised an error if a joint went on moving after it.

    A joint without torque may coast, no faster than what counts as standing.
    """
    went = np.abs(rest - closed.joints)
    coasts = np.array(still_speeds(rig.engine.capabilities)) * (rig.looks[-1].at - closed.at)
    allowed = 2.0 * rig.tolerance + (coasts if coasts.size == went.size else 0.0)
    moved = f"close() said nothing, and a joint went on by {went.max(initial=0.0):.4f}"
    rig.require(not is_silent or bool((went <= allowed).all()), moved)


def _is_told(rig: Rig, since: float) -> bool:
    """Whether the driver has measured the joints since then (monotonic s), or is in FAULT."""
    found = rig.valid("measured_js")
    return rig.status.state == "FAULT" or (found is not None and found[1].monotonic > since)


PROCEDURES: Mapping[Follows, Callable[[Rig, Way, str], Result]] = {
    Follows.STOPS: _stops,
    Follows.GOES_ON: _goes_on,
    Follows.HOLDS: _holds,
    Follows.STARTS_LATER: _starts_later,
    Follows.OUTLIVED: _outlived,
    Follows.RESTARTED: _restarted,
    Follows.KEPT_OUT: _kept_out,
    Follows.OBEYS: _obeys,
}
