"""What the drives are told to do in each cycle: hold, follow a stream, stop, change modes, move by their own.

At rest the joints hold in the best way that they all have (`CanopenConfig.ways`). Whatever else they do
begins and ends there: velocities and positions are slowed down within the limits, moves of the drives' own
are halted, and only then do the modes change, each with a target that is where the joint is.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Final

import numpy as np

from crtk_driver_canopen.arm_link import ArmLink
from crtk_driver_canopen.axis import Axis
from crtk_driver_canopen.braking import braking_time
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.given_rates import GivenRates
from crtk_driver_canopen.modes import HandshakePhase, Way
from crtk_driver_canopen.own_move import OwnMove
from crtk_driver_canopen.profiles import shared_rates, velocities_from_motion
from crtk_driver_canopen.standing import STOOD, Standing
from crtk_drivers.device import Goal, Mode, MoveProgress, Setpoint
from crtk_drivers.errors import CommandRefused, CrtkError
from crtk_drivers.samples import Vector, vector

MODE_TIME: Final = 2.0
"""Seconds in which all drives show a mode of operation."""

REACH_TIME: Final = 3.0
"""Seconds that a joint may stand in a move of its own before it tells that it is there."""

_TAKEN_OVER: Final = 5
"""Cycles, about, until a drive has a new set-point: those of its SDOs and of the handshake."""

STREAMED: Final[Mapping[Mode, Way]] = {
    Mode.JOINT_POSITION: Way.POSITIONS,
    Mode.JOINT_VELOCITY: Way.VELOCITIES,
    Mode.JOINT_EFFORT: Way.EFFORTS,
}


class _Phase(StrEnum):
    """What is going on; `way` says in which modes."""

    HOLD = "hold"
    FOLLOW = "follow"
    BRAKE = "brake"
    CHANGE = "change"
    PREPARE = "prepare"
    MOVE = "move"
    HALT = "halt"


class Motion:
    """The motion of all joints. Belongs to the I/O thread, but for `stop`.

    Args:
        config: of the arm.
        link: its drives.

    Attributes:
        way: what the drives are told to follow.
        fault: why the drives cannot go on, in words; empty if they can.
    """

    def __init__(self, config: CanopenConfig, link: ArmLink) -> None:
        joints = config.joints.values()
        self._config = config
        self._link = link
        self._velocities = np.array([joint.velocity for joint in joints])
        self._accelerations = np.array([joint.acceleration for joint in joints])
        self._lower = np.array([joint.lower for joint in joints])
        self._upper = np.array([joint.upper for joint in joints])
        self._arrival = np.array([joint.arrives_within for joint in joints])
        self._rest = next(iter(config.ways), Way.POSITIONS)
        self._stop = threading.Event()
        self._stop_since: float | None = None
        self._watched_for = self._looked = 0.0  # since it was told to stop; the last time
        self.rates = GivenRates(config, link)
        """What drives in profile modes hold."""
        self._standing = Standing(config)
        self.way = self._rest
        self.fault = ""
        self._phase = _Phase.HOLD
        self._waiting: Setpoint | None = None
        self._move: OwnMove | None = None
        self._began = 0.0
        self._held: Vector | None = None
        self._speed = np.zeros(len(self._velocities))
        self._target: list[int] = []
        self._unasked: list[Axis] = []

    # ------------------------------------------------------------------------------------ told by others

    @property
    def _axes(self) -> list[Axis]:
        return self._link.axes

    def begin(self) -> None:
        """The drives have just been found: they are to stay where they are."""
        self.way, self.fault, self._waiting, self._move = self._rest, "", None, None
        self._standing.begin([abs(axis.facts.units.position) for axis in self._axes])
        self._stop.clear()
        self._stop_since = None
        self.hold_here()
        self.rates.begin()

    def begin_anew(self, now: float) -> None:
        """Forget what was to be done, and hold still in the mode of rest; the drives may have no power."""
        self.fault, self._waiting, self._move = "", None, None
        self._stop.clear()
        self._stop_since = None
        self.use(self._rest, now)

    def note(self, positions: Vector, now: float) -> None:
        """Take where all joints are (n,)."""
        self._watched_for += min(now - self._looked, self._config.period)
        self._looked = now
        self._standing.note(positions, now)

    def note_unknown(self) -> None:
        """Not all joints told where they are."""
        self._standing.count_anew()

    @property
    def moving(self) -> bool:
        """Whether a joint moved between the last two samples."""
        return self._standing.moving

    @property
    def stopped(self) -> bool:
        """Whether the last stop has come to its end, as the drives show it: modes, and joints that stand."""
        return not self._stop.is_set() and self._stop_since is None

    def stopping_for(self, now: float) -> float:
        """Return for how many seconds a stop has been under way."""
        return 0.0 if self._stop_since is None else now - self._stop_since

    def unstopped(self, now: float) -> list[Axis]:
        """Return the axes that still move after the time in which they should have come to rest.

        A cycle counts as long as it should be: who was held up has slowed them down by no more than that.
        """
        if self._stop_since is None or self._watched_for < braking_time(self._config):
            return []
        moves = self._standing.moved_lately(now)
        return [axis for axis, moving in zip(self._axes, moves, strict=True) if moving]

    @property
    def takes_setpoints(self) -> bool:
        """Whether a setpoint takes effect at once."""
        return not self._stop.is_set() and self._phase in (_Phase.HOLD, _Phase.FOLLOW)

    @property
    def at_rest(self) -> bool:
        """Whether no stop and no change of mode is under way, and no joint moves."""
        under_way = self._phase in (_Phase.BRAKE, _Phase.CHANGE, _Phase.HALT)
        return not under_way and not self.moving

    @property
    def changes(self) -> bool:
        """Whether the mode is changing, or is going to when the joints stand."""
        return self._phase in (_Phase.CHANGE, _Phase.HALT)

    @property
    def setpoint(self) -> Vector | None:
        """The positions (n,) that the drives are told to be at; None where they are told something else."""
        return self._held

    def follow(self, setpoint: Setpoint, now: float) -> None:
        """Follow a setpoint; one of another kind begins with a change of mode."""
        way = STREAMED[setpoint.mode]
        self._waiting = setpoint
        if not self.takes_setpoints:
            return
        self._stop_since = None
        if way is not self.way:
            self.use(way, now)
        else:
            self._phase = _Phase.FOLLOW
            self._take(setpoint)

    def stop(self) -> None:
        """Come to rest, and hold: from the next cycle on. From any thread."""
        self._stop.set()

    def stop_at_once(self, now: float) -> None:
        """Begin to come to rest: torques end with the next SYNC."""
        self._stop.clear()
        self._begin_to_stop(now)

    def move(self, goal: Goal, now: float) -> None:
        """Have the drives move to a goal by themselves, as soon as they are in the mode for it."""
        self._move, self._waiting = OwnMove(goal), None
        if self.way is Way.MOVES and self._phase is not _Phase.CHANGE:
            self._prepare_move()
        elif self._phase is _Phase.HOLD:
            self._settle(now)
        elif self._phase is _Phase.FOLLOW:
            self._come_to_rest(now)

    def progress(self) -> MoveProgress:
        """Say where the move stands.

        Raises:
            MotionAborted: it has ended before its goal, and why.
        """
        move = self._move
        if move is None:
            return MoveProgress.FAILED
        return move.progress(self._link.where)

    def use(self, way: Way, now: float) -> None:
        """Change to the modes of a way, holding still."""
        self.hold_here()
        self.way, self._phase, self._began = way, _Phase.CHANGE, now
        self.rates.want_full()
        self._standing.count_anew()
        self._unasked = list(self._axes)
        self._ask_for_modes()

    def _ask_for_modes(self) -> None:
        """Want the modes of the way of those axes that did not have to wait for it.

        One that follows and is not heard has gone on: in a mode for positions it would jump back to where it
        was. Until it is heard it is told no velocity and no torque.
        """
        heard = dict(zip(self._axes, self._link.heard, strict=True))
        waiting = [axis for axis in self._unasked if axis.is_enabled and not heard[axis]]
        for axis in self._unasked:
            if axis not in waiting:
                axis.use(axis.mode_for(self.way))
        self._unasked = waiting

    def hold_here(self) -> None:
        """Have the drives stay where they are, in whatever mode they are."""
        outputs = self._link.outputs
        outputs.position[:] = self._link.positions
        count = len(outputs.position)
        outputs.velocity[:] = [0] * count
        outputs.torque[:] = [0] * count
        self._held = self._link.units.positions(self._link.positions)
        self._speed = np.zeros(count)
        self._phase = _Phase.HOLD

    # ------------------------------------------------------------------------------------- in each cycle

    def step(self, now: float) -> None:
        """Go on with what is under way."""
        if self._stop.is_set():
            self._stop.clear()
            self._begin_to_stop(now)
        going_on: dict[_Phase, Callable[[float], None]] = {
            _Phase.BRAKE: self._brake,
            _Phase.CHANGE: self._change,
            _Phase.PREPARE: self._prepare,
            _Phase.MOVE: self._follow_move,
            _Phase.HALT: self._halt,
        }
        if self._phase in going_on:
            going_on[self._phase](now)
        if (
            self._stop_since is not None
            and self._phase is _Phase.HOLD
            and self._standing.samples >= STOOD
        ):
            self._stop_since = None
            self._forgo()

    def _begin_to_stop(self, now: float) -> None:
        self._waiting = None
        if self._stop_since is None:
            self._stop_since = self._looked = now
            self._watched_for = 0.0
        if self._move is not None and self._move.waits:
            self._move.failure = "it was stopped"
        if any(axis.homing is not None for axis in self._axes):
            self._halt_homing()
        elif self._phase in (_Phase.PREPARE, _Phase.MOVE):
            self._begin_halt()
        elif self._phase is _Phase.FOLLOW:
            self._come_to_rest(now)

    def _forgo(self) -> None:
        """Hold joints where they are that did not get to where a stop was to end: they do not catch up."""
        if (
            self._held is not None
            and (np.abs(self._standing.positions - self._held) > self._arrival).any()
        ):
            self.hold_here()

    def _come_to_rest(self, now: float) -> None:
        """End a stream; what waits begins after that."""
        if self.way is not Way.EFFORTS:
            self._phase = _Phase.BRAKE
        elif self.way is self._rest:
            self.hold_here()
        else:
            self.use(self._rest, now)

    def _forgo_catching_up(self) -> None:
        """Stop joints that have not been heard where their drives were last told to be."""
        targets = self._link.targets
        if self.way is Way.POSITIONS and self._held is not None:
            behind = np.array([target.behind for target in targets])
            sent = self._link.units.positions([target.sent for target in targets])
            self._held = vector(np.where(behind, sent, self._held))
            self._speed = np.where(behind, 0.0, self._speed)

    def _settle(self, now: float) -> None:
        """The joints stand: begin what waits, or hold in the way of rest."""
        begins = self._move is not None and self._move.waits
        way = Way.MOVES if begins else self._rest
        if self.way is not way:
            self.use(way, now)
        elif begins:
            self._prepare_move()
        else:
            self._phase = _Phase.HOLD

    def _take(self, setpoint: Setpoint) -> None:
        """Have the drives follow a setpoint of the mode they are in."""
        units, outputs, values = self._link.units, self._link.outputs, setpoint.values
        if self.way is Way.POSITIONS:
            outputs.position[:] = units.position_counts(values)
            before = values if self._held is None else self._held
            speed = (values - before) / self._config.period
            self._speed = np.clip(speed, -self._velocities, self._velocities)
            self._held = values
            return
        self._held = None
        if self.way is Way.VELOCITIES:
            outputs.velocity[:] = units.velocity_counts(values)
            self._speed = np.array(values)
        else:
            outputs.torque[:] = units.effort_counts(values)

    def _brake(self, now: float) -> None:
        """Slow down within the limits of acceleration, and hold where that ends."""
        self._forgo_catching_up()
        period, units, outputs = self._config.period, self._link.units, self._link.outputs
        change = self._accelerations * period
        self._speed = np.sign(self._speed) * np.maximum(np.abs(self._speed) - change, 0.0)
        if self.way is Way.VELOCITIES:
            self._send(outputs.velocity, units.velocity_counts(vector(self._speed)))
        elif self._held is not None:
            here = self._held
            lowest, highest = np.minimum(self._lower, here), np.maximum(self._upper, here)
            self._held = vector(np.clip(here + self._speed * period, lowest, highest))
            self._send(outputs.position, units.position_counts(self._held))
        if not self._speed.any():
            self._settle(now)

    def _send(self, column: list[int], counts: list[int]) -> None:
        """Send to those drives only that follow; the others are told to be where they are."""
        for index, axis in enumerate(self._axes):
            if axis.is_enabled:
                column[index] = counts[index]

    def _change(self, now: float) -> None:
        self._ask_for_modes()
        outputs, positions = self._link.outputs, self._link.positions
        for index, axis in enumerate(self._axes):
            if not axis.shows_mode:
                outputs.position[index] = positions[index]
        try:
            # A drive in profile velocity mode goes by the rates that its last move was given.
            given = self.way is not Way.VELOCITIES or self.rates.give()
        except CrtkError as error:
            self._phase, self.fault = _Phase.HOLD, str(error)
            return
        late = [axis for axis in self._axes if axis in self._unasked or not axis.shows_mode]
        if given and not late:
            self._end_change(now)
        elif now - self._began > MODE_TIME:
            self._phase = _Phase.HOLD
            slow = ", ".join(axis.place for axis in late)
            self.fault = f"the mode of operation did not change: {slow or 'an SDO is not answered'}"

    def _end_change(self, now: float) -> None:
        waiting, self._waiting = self._waiting, None
        self._phase = _Phase.HOLD
        if waiting is not None and STREAMED[waiting.mode] is self.way:
            try:
                self._take(waiting)
            except CommandRefused as refusal:
                self.fault = str(refusal)
            else:
                self._phase, self._stop_since = _Phase.FOLLOW, None
        elif self.way is Way.POSITIONS and self.moving and self._link.velocities is not None:
            self.hold_here()  # and not where the change of modes began
            self._speed = np.array(self._link.units.velocities(self._link.velocities))
            self._phase = _Phase.BRAKE
        else:
            self._settle(now)

    # ------------------------------------------------------------------------------ moves of the drives' own

    def _prepare_move(self) -> None:
        """Let the drives have what the move needs; those that still move go on meanwhile."""
        assert self._move is not None
        self._stop_since = None
        goal = self._move.goal
        assert goal.joints is not None
        self._held = None
        self._target = self._link.units.position_counts(goal.joints)
        ways = goal.joints - self._link.units.positions(self._link.positions)
        velocities = self._velocities * goal.ratios.velocity
        accelerations = self._accelerations
        if self.moving:
            speeds = self._standing.speed
            ways = ways - speeds * _TAKEN_OVER * self._config.period
            velocities = velocities_from_motion(ways, speeds, velocities, accelerations)
        else:
            velocities, accelerations = shared_rates(
                ways, velocities, accelerations * goal.ratios.acceleration
            )
        self.rates.want(velocities, accelerations)
        self._phase = _Phase.PREPARE

    def _prepare(self, now: float) -> None:
        try:
            if not self.rates.give():
                return
        except CrtkError as error:
            self._fail_move(str(error))
            return
        for axis in self._axes:
            axis.handshake.start()
        self._phase = _Phase.MOVE
        self._standing.since = now

    def _follow_move(self, now: float) -> None:
        """Hand the targets over, and see whether all drives are there."""
        move, axes = self._move, self._axes
        assert move is not None
        for index, axis in enumerate(axes):
            if axis.is_enabled and axis.handshake.sends_target:
                self._link.outputs.position[index] = self._target[index]
        phases = [axis.handshake.phase for axis in axes]
        if HandshakePhase.FAILED in phases:
            told = [f"{axis.place}: {axis.handshake.failure}" for axis in axes]
            failed = zip(told, phases, strict=True)
            self._fail_move("; ".join(t for t, phase in failed if phase is HandshakePhase.FAILED))
        elif all(phase is HandshakePhase.REACHED for phase in phases):
            move.done, self._held = True, move.goal.joints
            self._settle(now)
        elif now - self._standing.since > REACH_TIME:
            slow = [axis.place for axis in axes if axis.handshake.phase < HandshakePhase.REACHED]
            self._fail_move(
                f"{', '.join(slow)}: it stands, but does not tell that it is there (bit 10 of the "
                "statusword); check its position window (6067h, 6068h) and limits (607Dh, 607Fh)"
            )

    def _fail_move(self, text: str) -> None:
        if self._move is not None:
            self._move.failure = text
        self._begin_halt()

    def _begin_halt(self) -> None:
        for axis in self._axes:
            axis.halt()
        self._wait_for_halt()

    def _wait_for_halt(self) -> None:
        self._phase, self._held = _Phase.HALT, None
        self._standing.count_anew()

    def _halt_homing(self) -> None:
        for axis in self._axes:
            axis.cancel_homing()
        if self._phase is not _Phase.HALT:
            self._wait_for_halt()

    def end_homing(self, now: float) -> None:
        """Homing is over, or given up: where it still runs it is halted, and left once the joints stand."""
        if all(axis.homing is None or axis.homing.over for axis in self._axes):
            self._leave_homing(now)
        else:
            self._halt_homing()

    def _leave_homing(self, now: float) -> None:
        for axis in self._axes:
            axis.end_homing()
        self.use(self._rest, now)

    def _halt(self, now: float) -> None:
        if self._standing.samples < STOOD:
            return
        homings = [axis.homing for axis in self._axes if axis.homing is not None]
        if not homings:
            self.hold_here()
            self._settle(now)
        elif all(homing.over for homing in homings):
            self._leave_homing(now)
