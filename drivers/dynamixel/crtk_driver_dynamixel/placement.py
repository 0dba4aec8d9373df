"""Where the servos of an open chain are: which turn each is in, and which homing offset it has.

Belongs to the I/O thread of its link (`crtk_driver_dynamixel.chain_link`), which reads and writes.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from crtk_driver_dynamixel.calibration import Calibration, unshifted
from crtk_driver_dynamixel.joints import Chain, servo_range
from crtk_driver_dynamixel.models import OperatingMode
from crtk_driver_dynamixel.readings import Frame
from crtk_driver_dynamixel.servo_state import ServoState, encoder_turn
from crtk_driver_dynamixel.turns import Placed, Turns, TurnsFile, has_turned
from crtk_drivers.errors import ConfigError, ConnectionFailed

logger = logging.getLogger(__name__)


class Placement:
    """By how many counts servos are elsewhere than they count, and how sure that is.

    Args:
        chain: as it is configured.
        calibration: of the chain, None if it has none.
        path: of the file of turns; empty: none is kept.

    Attributes:
        calibrated: servos of the calibration, by bus and id.
        configured: the chain as it is configured and calibrated.
        chain: the same, with the counts that are taken from what servos tell, and what their registers allow.
        doubts: why it is not known which turn a servo is in, by its place.
    """

    def __init__(self, chain: Chain, calibration: Calibration | None, path: str) -> None:
        self.configured = self.chain = chain
        self.calibrated = {} if calibration is None else calibration.by_place
        self._file = TurnsFile(path) if path else None
        self._turning = np.array(
            [
                place
                for place, servo in enumerate(chain.servos)
                if servo.units.mode is not OperatingMode.POSITION
            ],
            dtype=np.int64,
        )
        self.doubts: dict[int, str] = {}
        self._shifts: dict[int, int] = {}
        self._homing: dict[int, int] = {}
        self._states: Sequence[ServoState] = ()
        self._frame: Frame | None = None
        self._kept: Turns | None = None
        self._is_known = False

    def forget(self) -> None:
        """Take every servo to be where it counts, until it is looked for again."""
        self.chain = self.configured
        self._shifts, self._homing, self.doubts = {}, {}, {}
        self._is_known = False

    def find(self, states: Sequence[ServoState], frame: Frame, where: str) -> None:
        """Find the turns that servos are in, and what their registers allow; mark the file as not clean.

        Args:
            states: of the servos, which change as registers are read.
            frame: in which all have answered.
            where: they are.

        Raises:
            ConnectionFailed: the file cannot be read or written.
        """
        self._states, self._frame = states, frame
        self._homing = {place: self._other_homing(place) for place in range(len(states))}
        counts = [count - self._homing[i] for i, count in enumerate(frame.position.tolist())]
        try:
            known = None if self._file is None else self._file.load()
            if self._file is not None and known is None:
                found: Mapping[int, Placed] = self._first_turns(self._file)
            else:
                found = self.configured.turn_shifts(counts, known, self._has_run_on)
            turns = {place: turn.shift for place, turn in found.items()}
            for place, count in enumerate(frame.position.tolist()):
                if place not in turns:
                    turns[place] = self._turn_of_range(place, count) or 0
            self._shift({place: turns[place] + other for place, other in self._homing.items()})
            self.doubts = {
                place: f"{self.chain.servos[place].place} may be in another turn: {turn.doubt}"
                for place, turn in found.items()
                if turn.doubt
            }
            for doubt in self.doubts.values():
                logger.warning("%s: %s", where, doubt)
            self._is_known = True
            if self._file is not None:
                self._kept = self._turns(frame, clean=False)
                self._file.save(self._kept)
        except ConfigError as error:
            raise ConnectionFailed(error.message, where=error.where, remedy=error.remedy) from error

    def _first_turns(self, file: TurnsFile) -> dict[int, Placed]:
        """Return where servos are of which nothing was kept yet: where they count."""
        doubt = f"{file.path} does not exist yet, and it is taken to be in the turn that it counts"
        return {place: Placed(0, doubt) for place in self._turning.tolist()}

    def _has_run_on(self, place: int) -> bool:
        """Whether a servo has had its power since a driver enabled it: its bus watchdog is set."""
        return self._states[place].values.get("bus_watchdog", 0) != 0

    def trust(self, places: Iterable[int]) -> None:
        """Take these servos to be in the turns that they are believed to be in."""
        for place in places:
            self.doubts.pop(place, None)
        self._keep()

    def distrust(self, places: Iterable[int]) -> None:
        """Take these servos, if they have more than one turn, as not homed."""
        turning = set(self._turning.tolist())
        for place in turning.intersection(places):
            name = self.chain.servos[place].place
            self.doubts[place] = f"{name} may be in another turn: its position was given up"
        self._keep()

    def follow(self, frame: Frame) -> dict[int, int]:
        """Take the next frame; return which servos are back, and the counts that they may have forgotten.

        A servo forgets turns with its power: it begins anew within one, without torque. In modes of several
        turns it moved less than half a turn until then; in position mode it is in the turn of its range.
        """
        before, self._frame = self._frame, frame
        if before is None or not self._is_known:
            return {}
        found = {}
        turning = self._turning
        back = turning[frame.valid[turning] & ~before.valid[turning]]
        for place in back.tolist():
            counts = self.chain.servos[place].units.model.family.counts
            forgotten = round(int(frame.position[place] - before.position[place]) / counts)
            if forgotten:
                found[place] = forgotten * counts
        for place in np.flatnonzero(frame.valid & ~before.valid).tolist():
            if self.configured.servos[place].units.mode is OperatingMode.POSITION:
                turn = self._turn_of_range(place, int(frame.position[place]))
                known = self._shifts[place] - self._homing[place]
                if turn is not None and turn != known:
                    found[place] = turn - known
        return found

    def _turn_of_range(self, place: int, count: int) -> int | None:
        """Return by how many counts a servo in position mode is in another turn than it counts.

        After a start it counts within the turn of its encoder, which its range may go beyond: it can only be
        within that range. Such a servo is not enabled, but its position is right. None: it has counted on
        beyond that turn, and so has kept its power.
        """
        state = self._states[place]
        servo = self.configured.servos[place]
        family = servo.units.model.family
        first, last = encoder_turn(state.values, family)
        if not first <= count <= last:
            return None
        lower, upper = servo_range(servo.config)
        for turn in (0, family.counts, -family.counts):
            if lower <= servo.units.position(count - self._homing[place] - turn) <= upper:
                return turn
        return 0

    def has_forgotten(self, place: int, counts: int) -> None:
        """Take a servo as one that has forgotten turns, in counts."""
        self._shift({place: counts})
        self._keep()  # the shift of before would be believed after a crash

    def has_other_registers(self, place: int) -> None:
        """Look at the homing offset of a servo again."""
        other = self._other_homing(place)
        self._shift({place: other - self._homing[place]})
        self._homing[place] = other

    def keep_what_has_turned(self) -> None:
        """Keep where joints are, once one has turned far enough."""
        if self._kept is None:
            return
        frame, servos = self._frame, self.chain.servos
        assert frame is not None
        for place in self._turning.tolist():
            units = servos[place].units
            now = units.position(int(frame.position[place]))
            if servos[place].is_first and has_turned(
                units, self._kept.positions[servos[place].name], now
            ):
                self._keep()
                return

    @property
    def is_kept(self) -> bool:
        """Whether a file says where the servos are."""
        return self._file is not None and self._is_known

    def close(self, where: str, *, in_order: bool) -> None:
        """Mark the file as clean, if all is known.

        Args:
            in_order: all servos were just seen to stand.
        """
        file, self._kept = self._file, None
        is_known, self._is_known = self._is_known, False
        frame, self._frame = self._frame, None
        if file is None or not is_known or not file.end():
            return
        if self.doubts or frame is None or not in_order:
            return
        try:
            file.save(self._turns(frame, clean=True))
        except ConfigError as error:
            logger.warning("%s: %s", where, error)

    def _other_homing(self, place: int) -> int:
        """Return the counts by which the homing offset in a servo is another than that of the calibration."""
        state = self._states[place]
        wanted = self.calibrated.get((state.servo.bus, state.servo.id))
        if wanted is None or not state.has("homing_offset"):
            return 0
        units = state.servo.units
        found = state.values["homing_offset"]
        return unshifted(units, 0, wanted.homing_offset) - unshifted(units, 0, found)

    def _shift(self, shifts: Mapping[int, int]) -> None:
        """Take servos as counting otherwise than so far, by counts by place."""
        for place, shift in shifts.items():
            self._shifts[place] = self._shifts.get(place, 0) + shift
        placed = self.configured.with_shifts(self._shifts)
        self.chain = placed.with_registers([state.values for state in self._states])

    def _keep(self) -> None:
        if self._file is not None and self._is_known:
            assert self._frame is not None
            self._kept = self._turns(self._frame, clean=False)
            self._file.keep(self._kept)

    def _turns(self, frame: Frame, *, clean: bool) -> Turns:
        positions = self.chain.positions(self.chain.scaling.position.to_si(frame.position))
        shifts = {
            self.chain.servos[place].key: self._shifts.get(place, 0) - self._homing[place]
            for place in self._turning.tolist()
            if place not in self.doubts
        }
        named = dict(zip(self.chain.names, positions.tolist(), strict=True))
        return Turns(clean=clean, positions=named, shifts=shifts)
