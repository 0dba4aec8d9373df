"""An arm of a da Vinci Research Kit as a device of crtk-drivers that measures. Nothing is driven.

In each cycle all boards are asked for their state, one after the other, as dVRK does; what they tell together
is one sample.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Final

from typing_extensions import override

from crtk_driver_dvrk.arm import Joints, States, can_follow, wrong
from crtk_driver_dvrk.arm_file import DigitalInput, read_arm
from crtk_driver_dvrk.boards import Boards, Found, chosen
from crtk_driver_dvrk.config import DvrkConfig
from crtk_driver_dvrk.registers import (
    MIDDLE,
    WATCHDOG_STEP,
    BoardState,
    Register,
    preload,
    state_of,
)
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Capabilities,
    Condition,
    JointLimits,
    Note,
    Reading,
    Sensor,
    Severity,
    StopPolicy,
)
from crtk_drivers.errors import ConfigError, ConnectionFailed, ConnectionLost
from crtk_drivers.samples import Flag, Numbers, Sample, Stamp
from crtk_drivers.state import OperatingState

_NO_LIMIT: Final = JointLimits(
    lower=-math.inf, upper=math.inf, velocity=1e4, acceleration=1e6, jerk=1e8, effort=0.0
)
"""Nothing is sent to a joint."""

_TRIES: Final = 4
"""How often a register that is read once is asked for."""

_AGAIN: Final = 0.05
"""Seconds in which a state that was doubted is told again."""


class DvrkDevice(Sensor):
    """An arm.

    Args:
        config: where it is, and dVRK's files of it.

    Raises:
        ConfigError: a file cannot be used, or names do not fit it.
    """

    def __init__(self, config: DvrkConfig) -> None:
        self._config = config
        self._arm = arm = read_arm(config.io, config.robot, config.coupling)
        self._names = _joint_names(config, len(arm.actuators))
        self._joints = Joints(arm, self._names)
        self._used = {
            board: tuple(each.axis_id for each in arm.actuators if each.board_id == board)
            for board in arm.boards
        }
        self._boards = Boards(config.host, config.udp_port, config.told_at, config.reply_timeout)
        self._found: list[Found] = []
        self._about: list[Note] = []
        self._states: States = {}
        self._unset: tuple[int, ...] = ()  # boards with encoders that were never set, as read last
        self._coming: dict[int, BoardState] = {}
        self._doubted: dict[int, BoardState] = {}
        self._label: int | None = None  # of what has been asked for, and not answered
        self._asked = Stamp(0, 0.0)  # this reading began: what comes is no older
        self._before = 0.0  # monotonic s of the last one that came to its end
        self._wrong: dict[int, str] = {}  # why positions of a board cannot be relied on
        self._counted = dict.fromkeys(
            ("readings", "lost replies", "doubted states", "encoder errors"), 0
        )
        measured = ("measured_js", "measured2_js") if arm.has_potentiometers else ("measured_js",)
        self._capabilities = Capabilities(
            joints=self._names,
            joint_units=tuple(
                "m" if each.joint_type == "PRISMATIC" else "rad" for each in arm.actuators
            ),
            limits=(_NO_LIMIT,) * len(self._names),
            measured=measured,
            rate=config.rate,
            stop=StopPolicy(0.0, "is only read: whatever drives it stops it"),
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return f"{self._config.host}:{self._config.udp_port}"

    @property
    @override
    def condition(self) -> Condition:
        if trouble := self._trouble:
            return Condition(OperatingState.FAULT, trouble)
        return Condition()

    @property
    def _trouble(self) -> str:
        told = (f"board {board}: {text}" for board, text in self._wrong.items() if text)
        return "; ".join(told)

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        own = self._boards
        return {
            **self._counted,
            "stray datagrams": own.strays,
            "damaged datagrams": own.damaged,
            "dropped requests": own.dropped,
        }

    # ------------------------------------------------------------------------------------ open, close

    @override
    def open(self, deadline: float) -> None:
        self._states, self._doubted, self._wrong = {}, {}, {}
        self._begin()
        boards = self._arm.boards
        found = self._boards.open(deadline, boards)
        self._reached(found)
        self._found = chosen(found, boards, self._boards.where)
        self._about = self._told_once(deadline)

    def _reached(self, found: list[Found]) -> None:
        """These boards are there; whether they are those of the arm is looked at next."""

    @override
    def abort_open(self) -> None:
        self._boards.abort_open()

    @override
    def close(self) -> None:
        self._boards.close()
        self._states = {}  # readings tell nothing that was
        self._unset = ()

    def _told_once(self, deadline: float) -> list[Note]:
        """Return what boards tell of themselves that does not change while they are only read."""
        arm = self._arm
        name = f"{arm.name} {arm.serial_number}".strip()
        notes = [Note(Severity.INFO, "arm", f"{name}, boards {', '.join(map(str, arm.boards))}")]
        preloads: dict[int, list[int]] = {}
        for each in self._found:
            period = self._once(each, Register.WATCHDOG, deadline) * WATCHDOG_STEP
            text = f"FPGA V{each.fpga}, {each.hardware_name}, firmware {each.firmware}, node {each.node}; "
            text += f"watchdog {1000.0 * period:.0f} ms" if period else "watchdog off"
            notes.append(Note(Severity.INFO, f"board {each.board}", text))
            preloads[each.board] = [
                self._once(each, preload(at), deadline) for at in self._used[each.board]
            ]
        self._unset = tuple(board for board, loads in preloads.items() if MIDDLE in loads)
        unset = [str(board) for board in self._unset if set(preloads[board]) == {MIDDLE}]
        if unset:
            text = (
                f"those of board {', '.join(unset)} were not set since it was switched on: positions count "
                "from where the arm was then, until dVRK has homed it"
            )
            notes.append(Note(Severity.WARNING, "encoders", text))
        return notes

    def _once(self, board: Found, address: int, deadline: float) -> int:
        found = self._boards.register(board.node, address, deadline, _TRIES)
        if found is None:
            raise ConnectionFailed(
                f"board {board.board} does not tell register {address}", where=self._boards.where
            )
        return found & 0xFFFF if address == Register.WATCHDOG else found

    # ------------------------------------------------------------------------------------------ cycle

    @override
    def read(self, deadline: float) -> Sample | None:
        while len(self._coming) < len(self._found):
            board = self._found[len(self._coming)]
            if self._label is None:
                self._ask(board)
            assert self._label is not None
            reply = self._boards.answer(board.node, self._label, deadline)
            now = time.monotonic()
            if reply is None:
                if now - self._asked.monotonic > self._config.reply_timeout:
                    self._counted["lost replies"] += 1
                    self._begin()
                return None
            self._label = None
            state = self._believed(board, reply.quadlets, now)
            if state is None:
                self._begin()
                return None
            self._coming[board.board] = state
        states = self._coming
        self._states, self._before = states, self._asked.monotonic
        self._counted["readings"] += 1
        self._counted["encoder errors"] += sum(
            self._joints.axis(states, actuator).jumped for actuator in self._arm.actuators
        )
        self._begin()
        stamp = Stamp(0, self._asked.monotonic) if self._trouble else self._asked
        return Sample(stamp, self._joints.values(states))

    def _begin(self) -> None:
        """Let the next cycle ask all boards anew."""
        self._coming, self._label = {}, None

    def _ask(self, board: Found) -> None:
        if not self._coming:
            self._asked = Stamp.now()
        self._label = self._boards.ask_state(board.node)

    def _believed(self, board: Found, quadlets: tuple[int, ...], now: float) -> BoardState | None:
        """Return a state that can be believed; what is strange is, when the next one tells the same."""
        number = board.board
        try:
            state = state_of(quadlets)
        except ValueError:
            self._boards.damaged += 1
            return None
        axes, before = self._used[number], self._states.get(number)
        found = wrong(state, number, axes)
        doubted = self._doubted.pop(number, None)
        follows = before is None or can_follow(state, before, axes, now - self._before)
        if found or not follows:
            told_before = doubted is not None and wrong(doubted, number, axes) == found
            if doubted is None or not (told_before and can_follow(state, doubted, axes, _AGAIN)):
                self._doubted[number] = state
                self._counted["doubted states"] += 1
                return None
        if state.board != number:
            raise ConnectionLost(
                f"board {number} is another one: {found}",
                where=self._boards.where,
                remedy="Was it replaced, or its rotary switch turned? The driver connects again by itself.",
            )
        self._wrong[number] = found
        return state

    # ----------------------------------------------------------------------------------------- health

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        return (*self._about, *(note for each in self._states.values() for note in self._of(each)))

    def _of(self, state: BoardState) -> list[Note]:
        """Return how a board is."""
        key = f"board {state.board} power"
        notes = [
            Note(Severity.INFO, key, _power(state)),
        ]
        told = (
            (Severity.WARNING, "watchdog has expired: all amplifiers are off", state.timed_out),
            (
                Severity.ERROR,
                "motor supply has a fault (over-voltage, over-current)",
                state.supply_fault,
            ),
        )
        notes += [
            Note(severity, f"board {state.board}", text) for severity, text, is_so in told if is_so
        ]
        for name, actuator in zip(self._names, self._arm.actuators, strict=True):
            if actuator.board_id != state.board:
                continue
            axis = state.axes[actuator.axis_id]
            if axis.is_tripped:
                text = "switched off by the board: its current was not what was asked for"
                notes.append(Note(Severity.ERROR, f"amplifier of {name}", text))
            elif axis.has_fault:
                notes.append(
                    Note(Severity.ERROR, f"amplifier of {name}", "tells a fault: too hot?")
                )
        return notes

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        flags: dict[str, tuple[str, Callable[[States], bool]]] = {
            "motor_power": (
                "whether all motors have their voltage",
                _all(lambda s: s.voltage_good),
            ),
            "safety_relay": (
                "whether all safety relays are closed",
                _all(lambda s: s.relay_closed),
            ),
            "watchdog_expired": (
                "whether the watchdog of a board has expired",
                lambda states: any(state.timed_out for state in states.values()),
            ),
        }
        numbers: dict[str, tuple[str, Callable[[States], tuple[float, ...]]]] = {
            "currents": ("current of each actuator, A", self._joints.currents),
            "amplifiers": (
                "1 for each actuator whose amplifier is on",
                lambda states: tuple(
                    float(self._joints.axis(states, actuator).is_on)
                    for actuator in self._arm.actuators
                ),
            ),
            "temperatures": (
                "°C of the amplifiers: two for each board",
                lambda states: tuple(t for state in states.values() for t in state.temperatures),
            ),
        }
        if self._arm.has_potentiometers:
            numbers["potentiometers"] = (
                "what each potentiometer measures, rad (m)",
                self._joints.potentiometers,
            )
        return {
            **{
                name: Reading(summary, Payload.FLAG, self._flag(tell))
                for name, (summary, tell) in flags.items()
            },
            **{
                name: Reading(summary, Payload.NUMBERS, self._numbers(tell))
                for name, (summary, tell) in numbers.items()
            },
            **{
                name: Reading(
                    f"whether {each.name} is pressed", Payload.FLAG, self._flag(_pressed(each))
                )
                for name, each in self._arm.inputs.items()
            },
        }

    def _flag(self, tell: Callable[[States], bool]) -> Callable[[], Flag | None]:
        return lambda: Flag(tell(states)) if (states := self._states) else None

    def _numbers(self, tell: Callable[[States], tuple[float, ...]]) -> Callable[[], Numbers | None]:
        return lambda: Numbers(tell(states)) if (states := self._states) else None


def _all(tell: Callable[[BoardState], bool]) -> Callable[[States], bool]:
    return lambda states: all(map(tell, states.values()))


def _pressed(button: DigitalInput) -> Callable[[States], bool]:
    def tell(states: States) -> bool:
        bit = bool(states[button.board_id].inputs >> button.bit_id & 1)
        return bit == button.pressed_value

    return tell


def _power(state: BoardState) -> str:
    motors = "on" if state.voltage_good else "asked for, and not there" if state.power else "off"
    relay = "closed" if state.relay_closed else "asked for, and open" if state.relay else "open"
    on = sum(axis.is_on for axis in state.axes)
    return f"motors {motors}; safety relay {relay}; {on} of {len(state.axes)} amplifiers on"


def _joint_names(config: DvrkConfig, count: int) -> tuple[str, ...]:
    names = config.joint_names or tuple(f"joint_{at}" for at in range(1, count + 1))
    if len(names) != count:
        raise ConfigError(
            f"joint_names: {len(names)} names for {count} actuators",
            where="dvrk",
            remedy="Give one for each, or none.",
        )
    return names
