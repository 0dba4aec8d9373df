"""What an arm's boards are told while they are driven, and whether they do it. From any thread.

Nothing is sent before `begin`. From then on each cycle sends something: the currents of a setpoint, or zero
where none came since the cycle before. That feeds the boards' watchdogs, so a driver that hangs or is killed
lets them expire. After `off` each cycle sends that amplifiers and power are off, with zero currents, until
the boards tell that it is so; then nothing is sent any more, and the watchdogs, which stay armed, expire.
A packet of before that comes later than that, and switches on again, is noticed for 2 s.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from enum import Enum, auto
from typing import Final

from crtk_driver_dvrk.arm import States
from crtk_driver_dvrk.boards import Boards
from crtk_driver_dvrk.motor_file import Motor
from crtk_driver_dvrk.orders import Motor as Order
from crtk_driver_dvrk.orders import order
from crtk_driver_dvrk.registers import AxisState
from crtk_driver_dvrk.safeguards import Trouble
from crtk_drivers.errors import ConnectionLost

_KEPT: Final = 0.5
"""Seconds for which currents that were sent are known as ours."""

_SEEN_OFF: Final = 3
"""Readings in a row that must tell that all is off: a packet of before may be on its way still."""

_LATE: Final = 2.0
"""Seconds after that was told in which power comes by a packet of ours that was on its way so long."""

_BEHIND: Final = 5
"""Samples in a row in which a board may not have taken what was sent last."""

_FOREIGN: Final = 2
_WITHIN: Final = 1.0
"""In how many samples within how many seconds a current may not be ours: two are another program's."""

_TAKEN: Final = Trouble(
    "currents that this driver did not send were written: another program drives the arm",
    "End it (dVRK's own program?), then send enable.",
)


_Sent = tuple[float, tuple[int, ...]]
"""Monotonic seconds, and currents of all motors."""


class _Wish(Enum):
    """What boards are to be."""

    NOTHING = auto()  # not ours
    POWERING = auto()  # power is being switched on, currents are zero
    ON = auto()
    OFF = auto()


class Drive:
    """Tells boards.

    Args:
        boards: the way to them.
        motors: of the arm, in their order.
        zero: what no current is for each of them.
    """

    def __init__(self, boards: Boards, motors: tuple[Motor, ...], zero: tuple[int, ...]) -> None:
        self._boards = boards
        self._motors = motors
        self._zero = zero
        self._lock = threading.Lock()
        self._nodes: Mapping[int, int] = {}
        self._wish = _Wish.NOTHING
        self._was_written = False  # in this cycle
        self._sent: deque[_Sent] = deque()
        self._stopped = math.inf  # monotonic s at which zero or off was sent
        self._is_zero = True  # that was read back
        self._seen_off = 0
        self._was_off = -math.inf  # monotonic s at which off was read back
        self._opened: frozenset[int] = frozenset()  # boards whose relays are opened with `off`
        self._behind = dict.fromkeys((motor.board for motor in motors), 0)
        self._strange: list[float] = []
        self.late_writes = self.late_switches = self.foreign_currents = 0

    def reached(self, nodes: Mapping[int, int]) -> None:
        """The boards of the arm have been found anew, at these nodes, by number."""
        with self._lock:
            self._nodes = nodes

    # ------------------------------------------------------------------------------------------- told

    @property
    def is_on(self) -> bool:
        """Whether amplifiers are on, as far as it goes by us."""
        return self._wish is _Wish.ON

    @property
    def is_idle(self) -> bool:
        """Whether amplifiers are on, and currents are zero since no setpoint is in force."""
        return self._wish is _Wish.ON and self._stopped < math.inf

    @property
    def is_powering(self) -> bool:
        """Whether `begin` is followed by no end yet."""
        return self._wish is _Wish.POWERING

    @property
    def is_free(self) -> bool:
        """Whether nothing is sent: boards are not ours, or off, which was read back."""
        return self._wish is _Wish.NOTHING

    @property
    def has_stopped(self) -> bool:
        """Whether the last zero, or off, was read back."""
        return self._wish in (_Wish.NOTHING, _Wish.POWERING) or (
            self._wish is _Wish.ON and self._is_zero
        )

    # ------------------------------------------------------------------------------------------- tell

    def begin(self) -> None:
        """Send zero currents from now on, if boards are not ours yet; amplifiers and power stay as they are.

        Raises:
            ConnectionLost: the connection is gone.
        """
        with self._lock:
            if self._wish is _Wish.NOTHING:
                self._wish, self._opened = _Wish.POWERING, frozenset()
                self._send(self._zero)

    def on(self) -> None:
        """Amplifiers are on: setpoints may be sent from now on."""
        with self._lock:
            if self._wish is _Wish.POWERING:
                self._wish, self._is_zero, self._stopped = _Wish.ON, False, time.monotonic()
                self._behind = dict.fromkeys(self._behind, 0)
                self._strange.clear()

    def switch(
        self,
        *,
        amplifier: Motor | None = None,
        power: bool | None = None,
        relay: bool | None = None,
    ) -> None:
        """Switch on one amplifier, power or relays of all boards, with zero currents, while powering up.

        Raises:
            ConnectionLost: the connection is gone.
        """
        with self._lock:
            if self._wish is _Wish.POWERING:
                self._send(self._zero, amplifier=amplifier, power=power, relay=relay)

    def currents(self, bits: tuple[int, ...]) -> None:
        """Send the currents of a setpoint, unless amplifiers are not on any more.

        Raises:
            ConnectionLost: the connection is gone.
        """
        with self._lock:
            if self._wish is _Wish.ON:
                self._was_written = True
                self._is_zero, self._stopped = False, math.inf
                self._send(bits)

    def zero(self) -> None:
        """Send zero currents, if amplifiers are on. Sent again, it is read back by what was asked before."""
        with self._lock:
            if self._wish is _Wish.ON:
                self._end_setpoint()
                self._send_anyway()

    def off(self, relays: Collection[int] = ()) -> None:
        """Switch off, from now on until that is read back.

        Args:
            relays: boards whose safety relays are opened too.
        """
        with self._lock:
            if self._wish is _Wish.NOTHING:
                return
            self._switch_off(relays)

    def off_found(self, states: States) -> None:
        """Do so also where nothing is ours, but boards tell that power or an amplifier is on."""
        with self._lock:
            if self._wish is _Wish.NOTHING and self._tell_on(states):
                self._opened = frozenset()
                self._switch_off()

    def _switch_off(self, relays: Collection[int] = ()) -> None:
        if self._wish is not _Wish.OFF:
            self._wish, self._stopped, self._seen_off = _Wish.OFF, time.monotonic(), 0
        self._opened |= set(relays)
        self._send_anyway()

    def cycle(self) -> None:
        """Send what a cycle has to, before boards are asked for their state.

        Raises:
            ConnectionLost: the connection is gone.
        """
        with self._lock:
            was_written, self._was_written = self._was_written, False
            if self._wish is _Wish.NOTHING or (self._wish is _Wish.ON and was_written):
                return
            if self._wish is _Wish.ON:
                self._end_setpoint()  # no other one came: it is stale
            self._send(self._zero, off=self._wish is _Wish.OFF)

    def _end_setpoint(self) -> None:
        if self._stopped == math.inf:
            self._stopped, self._is_zero = time.monotonic(), False

    def _send_anyway(self) -> None:
        """Send zero, or off. A link that is gone is told by the next reading; watchdogs switch off then."""
        with contextlib.suppress(ConnectionLost):
            self._send(self._zero, off=self._wish is _Wish.OFF)

    def _send(
        self,
        bits: tuple[int, ...],
        *,
        off: bool = False,
        amplifier: Motor | None = None,
        power: bool | None = None,
        relay: bool | None = None,
    ) -> None:
        now = time.monotonic()
        self._sent.append((now, bits))
        while self._sent[0][0] < now - _KEPT:
            self._sent.popleft()
        if off:
            power = False
        lost: ConnectionLost | None = None
        for board, node in self._nodes.items():
            told = {
                motor.axis: Order(current, False if off else True if motor is amplifier else None)
                for motor, current in zip(self._motors, bits, strict=True)
                if motor.board == board
            }
            is_opened = off and board in self._opened
            quadlets = order(board, told, power=power, relay=False if is_opened else relay)
            try:
                self._boards.order(node, quadlets)
            except ConnectionLost as error:
                lost = error  # the other boards are told all the same
        if lost is not None:
            raise lost

    # -------------------------------------------------------------------------------------- read back

    def take(self, states: States, asked: float) -> None:
        """Look whether what was sent has been done.

        Args:
            states: of all boards.
            asked: monotonic seconds at which the first one was asked for.
        """
        with self._lock:
            if asked <= self._stopped:
                return
            if self._wish is _Wish.OFF:
                is_open = not any(states[board].relay for board in self._opened)
                is_off = is_open and not self._tell_on(states)
                self._seen_off = self._seen_off + 1 if is_off else 0
                if self._seen_off >= _SEEN_OFF:
                    self._wish, self._was_off = _Wish.NOTHING, asked
            elif self._wish is _Wish.ON:
                self._is_zero = self.is_zero(states)
            elif self._wish is _Wish.NOTHING and self._is_late_on(states, asked):
                self.late_switches += 1
                self._switch_off()

    def _is_late_on(self, states: States, asked: float) -> bool:
        return asked - self._was_off < _LATE and self._tell_on(states)

    def _tell_on(self, states: States) -> bool:
        """Whether boards tell that motors have power, or that an amplifier of the arm is on."""
        has_power = any(state.power for state in states.values())
        return has_power or not all(_axis(states, motor).is_off for motor in self._motors)

    def is_zero(self, states: States) -> bool:
        """Whether boards tell zero currents for all motors of the arm."""
        rows = zip(self._motors, self._zero, strict=True)
        return all(_axis(states, motor).command == zero for motor, zero in rows)

    def trouble(self, states: States, asked: float) -> Trouble | None:
        """Return what is wrong with the currents that boards tell; None if they are as they were sent.

        Args:
            states: of all boards.
            asked: monotonic seconds at which the first one was asked for.
        """
        with self._lock:
            sent = list(self._sent)
        for board in self._behind:
            found = self._told(states, board)
            if self._is_due(found, board, sent, asked):
                self._behind[board] = 0
                continue
            self._behind[board] += 1
            if all(self._part(bits, board) != found for _, bits in sent):
                self.foreign_currents += 1
                self._strange = [at for at in self._strange if asked - at <= _WITHIN] + [asked]
                if len(self._strange) >= _FOREIGN:
                    return _TAKEN
                continue
            self.late_writes += 1
            if self._behind[board] >= _BEHIND:
                return Trouble(
                    f"board {board} does not take the currents that are sent",
                    "Look at the network of the boards, then send enable.",
                )
        return None

    def _is_due(
        self, found: tuple[int, ...], board: int, sent: Sequence[_Sent], asked: float
    ) -> bool:
        """Whether a board tells what was sent last before it was asked, or since."""
        for at, bits in reversed(sent):
            if self._part(bits, board) == found:
                return True
            if at < asked:
                return False
        return True

    def _told(self, states: States, board: int) -> tuple[int, ...]:
        return tuple(_axis(states, motor).command for motor in self._motors if motor.board == board)

    def _part(self, bits: tuple[int, ...], board: int) -> tuple[int, ...]:
        rows = zip(self._motors, bits, strict=True)
        return tuple(current for motor, current in rows if motor.board == board)


def _axis(states: States, motor: Motor) -> AxisState:
    return states[motor.board].axes[motor.axis]
