"""The line to the servos of a chain: found, read once a cycle, written, each with an age and a health.

Belongs to one I/O thread. Nothing here knows modes or CRTK: counts in, counts out, in the order of the
chain's servos (`crtk_driver_dynamixel.joints`).
"""

from __future__ import annotations

import logging
import math
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crtk_driver_dynamixel.blocks import BlockReads, Member, values_of
from crtk_driver_dynamixel.bus import Bus
from crtk_driver_dynamixel.calibration import Calibration
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.control_tables import POSITION, Item, control_table
from crtk_driver_dynamixel.groups import GroupWrite
from crtk_driver_dynamixel.joints import Chain, ChainServo
from crtk_driver_dynamixel.models import GOALS, model_numbered
from crtk_driver_dynamixel.placement import Placement
from crtk_driver_dynamixel.protocols import PROTOCOLS
from crtk_driver_dynamixel.readings import HEALTH, MEASURED, SLOW, Frame, Health, Silences
from crtk_driver_dynamixel.registers import WATCHDOG_STEP
from crtk_driver_dynamixel.replies import ServoCorrupt, ServoRefused, ServoSilent
from crtk_driver_dynamixel.servo_state import ServoState, Values, runs
from crtk_driver_dynamixel.units import Counts, encoded
from crtk_drivers.errors import ConfigError, ConnectionFailed, ConnectionLost, DeviceError
from crtk_drivers.kit import RoundRobin
from crtk_drivers.kit.serial_port import SerialPort
from crtk_drivers.samples import Stamp

logger = logging.getLogger(__name__)

PATIENCE: Final = 0.1
"""Seconds allowed to adapter and system while the chain is opened: whatever is done first is slow."""

MODEL_NUMBER_1: Final = 0
"""Address of model number (2 bytes) and, in protocol 1.0, whose ping tells neither, firmware (1)."""

OUTSIDE_TIMES: Final = 3
"""Times that a stop is sent from another thread."""
OUTSIDE_PAUSE: Final = 0.01
"""Seconds between them, and for which a write of the I/O thread is waited for."""
GAP: Final = 0.05
"""Seconds of silence after which a servo that answers again may have been without power."""
LAST_LOOKS: Final = 3
"""Times that servos are read before the ports are closed, until all are seen to stand."""
STANDING: Final = 0.03
"""rad/s of a servo below which it stands; a count of the X series is 0.024."""

GroupKey = tuple[str, int, int, int]
"""Bus, protocol, address, length."""


class _GoalWrite(NamedTuple):
    """A group write of goals.

    Attributes:
        write: of one register of some servos.
        members: of these servos among those of the register.
        item: the register.
        is_older: some of them may be sent goals only at times; see `ChainLink.takes_goals`.
    """

    write: GroupWrite
    members: NDArray[np.int64]
    item: Item
    is_older: bool


@dataclass(slots=True)
class _Prepared:
    """What is prepared for the cycles of an open chain."""

    measured: BlockReads
    slow: RoundRobin[BlockReads]
    goals: dict[str, list[_GoalWrite]] = field(default_factory=dict)


class ServoMute(DeviceError):
    """A servo answers a ping, and no read."""

    def __init__(self) -> None:
        super().__init__(
            "it answers a ping, and no read: its Status Return Level is 0",
            remedy="Set Status Return Level to 1 or 2 with DYNAMIXEL Wizard: 68 in the X series, where a "
            "power cycle does it too, 16 in AX and MX(1.0), 17 in the XL-320.",
        )


class ChainLink:
    """The servos of one chain.

    Args:
        config: buses, times.
        chain: the servos.
        calibration: of the chain, None if it has none.
        finds_turns: open it only if it can be told which turn each servo is in; else positions are as the
            servos count, until `Placement.find` is called.

    Attributes:
        placement: where the servos are.
        silences: of the servos.
    """

    def __init__(
        self,
        config: DynamixelConfig,
        chain: Chain,
        calibration: Calibration | None = None,
        *,
        finds_turns: bool = True,
    ) -> None:
        self._config = config
        self._finds_turns = finds_turns
        self.placement = Placement(chain, calibration, config.turns)
        self.states: list[ServoState] = []
        self.health = [_health(servo) for servo in chain.servos]
        self.frame: Frame | None = None
        self.silences = Silences(len(chain.servos))
        self.cycles = 0
        self._users = 0
        self._buses: dict[str, Bus] = {}
        self._settled: set[str] = set()
        self._prepared: _Prepared | None = None

    # ----------------------------------------------------------------------------------- life cycle

    @property
    def chain(self) -> Chain:
        """The servos, as they count now."""
        return self.placement.chain

    @property
    def address(self) -> str:
        """Its ports."""
        return ", ".join(self._config.bus(name).port or "no port" for name in self._names())

    def open(self, deadline: float) -> None:
        """Open the ports and find every servo; once for all who call it, until each has called `close`.

        Nothing is written.

        Raises:
            ConnectionFailed: a port cannot be opened, or a servo is missing or is another model.
        """
        if self._users == 0:
            try:
                self._open(deadline)
            except BaseException:
                self._close()
                raise
        self._users += 1

    def close(self) -> None:
        """Close the ports when nobody uses them any more; the servos stay as they are."""
        self._users = max(0, self._users - 1)
        if self._users == 0:
            self._close()

    def _names(self) -> list[str]:
        return list(dict.fromkeys(servo.bus for servo in self.chain.servos))

    def _open(self, deadline: float) -> None:
        for name in self._names():
            given = self._config.bus(name)
            bus = Bus(SerialPort(given.port, given.baud), latency_budget=PATIENCE)
            bus.open()
            self._buses[name] = bus
        self._settled.clear()
        self.placement.forget()
        self.health = [_health(servo) for servo in self.chain.servos]
        self.states = []
        missing = []
        for place, servo in enumerate(self.chain.servos):
            if time.monotonic() > deadline:
                raise ConnectionFailed(
                    f"the time was over before {servo.place} was found",
                    where=self.address,
                    remedy="Raise open_timeout; servos answer fast at 1 Mbit/s and slowly at 57600.",
                )
            try:
                self.states.append(self._find(servo))
            except ServoMute as error:
                raise ConnectionFailed(
                    f"{servo.place}: {error.message}", where=self.address, remedy=error.remedy
                ) from error
            except (ServoSilent, ServoCorrupt, ServoRefused) as error:
                missing.append(f"{servo.place}: {error.message}")
                continue
            except ConfigError as error:
                raise ConnectionFailed(
                    f"{servo.place}: {error.message}", where=self.address, remedy=error.remedy
                ) from error
            self._take_state(place, self.states[-1])
        if missing:
            raise ConnectionFailed(
                "; ".join(missing),
                where=self.address,
                remedy="Check power, cables, ids, baud rate: 'crtk-driver dynamixel scan' shows who answers.",
            )
        self._prepare()
        self._let_watchdogs_act(deadline)
        self._place()
        for bus in self._buses.values():
            bus.latency_budget = self._config.latency_budget

    def _let_watchdogs_act(self, deadline: float) -> None:
        """Say nothing on the lines for as long as servos that turn by an armed watchdog need to stop.

        It counts whatever is said on its line: a driver that has just been started, or a link that is opened
        again, would keep a servo turning that nobody commands any more.
        """
        self.exchange()
        places = range(len(self.states))
        armed = [
            WATCHDOG_STEP * self.states[place].values["bus_watchdog"]
            for place in self.turning(places)
            if self.states[place].values.get("bus_watchdog", 0) > 0
        ]
        if armed:
            time.sleep(max(0.0, min(max(armed) + WATCHDOG_STEP, deadline - time.monotonic())))
            self.read_health(places)
            for place, values in self.read_values(
                places, ["torque_enable", "bus_watchdog"]
            ).items():
                self.learn(place, values)
            self.exchange()

    def answers(self, place: int) -> bool:
        """Whether a servo answered in the last cycle."""
        return self.frame is not None and bool(self.frame.valid[place])

    def takes_goals(self, place: int) -> bool:
        """Whether a servo may be sent a goal: without torque, an older one would take it and turn there.

        It may have lost its power, and have fallen, as long as it is not heard.
        """
        if not self.chain.servos[place].units.model.family.is_older:
            return True
        return self.answers(place) and self.health[place].torque is True

    def rests(self, place: int) -> bool:
        """Whether a servo was seen to stand in the last cycle."""
        if self.frame is None or not self.answers(place):
            return False
        unit = self.chain.servos[place].units.model.family.velocity_unit
        return abs(int(self.frame.velocity[place])) * unit < STANDING

    def turning(self, places: Iterable[int]) -> list[int]:
        """Return which servos turn with torque, or have a goal of theirs by which they may turn on and on."""
        driven = {int(mode): name for mode, name in GOALS.items()}
        found = self.read_values(places, ["torque_enable", "operating_mode", *GOALS.values()])
        return [
            place
            for place, values in found.items()
            if values.get("torque_enable")
            and (
                values.get(driven.get(values.get("operating_mode", 3), ""), 0)
                or not self.rests(place)
            )
        ]

    def _place(self) -> None:
        """Find where servos are, once all answer."""
        frame = self.exchange()
        if not frame.valid.all():
            silent = [self.chain.servos[i].place for i in np.flatnonzero(~frame.valid)]
            raise ConnectionFailed(
                f"{', '.join(silent)} answers a ping, and no group read",
                where=self.address,
                remedy="Set fast_read to false, or raise latency_budget.",
            )
        if self._finds_turns:
            self.placement.find(self.states, frame, self.address)

    def _close(self) -> None:
        self.placement.close(
            self.address, in_order=self.placement.is_kept and self._are_seen_to_stand()
        )
        buses, self._buses = self._buses, {}
        for bus in buses.values():
            bus.close()
        self.frame = self._prepared = None

    def _are_seen_to_stand(self) -> bool:
        """Whether all servos, read once more, are there and stand: what was read before may be old."""
        try:
            for _ in range(LAST_LOOKS):
                self.exchange()
                places = range(len(self.states))
                if all(map(self.rests, places)) and not self.turning(places):
                    return True
        except ConnectionLost:
            pass  # who closes it knows
        return False

    def _find(self, servo: ChainServo) -> ServoState:
        """Return a servo as it is, after a look at who it is."""
        bus = self._buses[servo.bus]
        bus.set_link(servo.id, protocol=servo.protocol)
        if servo.bus not in self._settled:
            bus.ping(servo.id)  # it is there, or something late seems to say so
            try:
                bus.settle(servo.id)
            except ServoSilent as error:
                raise ServoMute from error
            self._settled.add(servo.bus)
        found = bus.ping(servo.id)
        number, firmware = found.model, found.firmware
        try:
            data = bus.read(servo.id, MODEL_NUMBER_1, 3)
        except ServoSilent as error:
            raise ServoMute from error
        if servo.protocol == 1:
            number, firmware = int.from_bytes(data[:2], "little"), data[2]
        wanted = servo.units.model
        if number != wanted.number:
            other = model_numbered(number, f"{self.address} id {servo.id}")
            raise ConnectionFailed(
                f"{servo.place} is a {other.name}, and {wanted.name} is configured",
                where=self.address,
                remedy="Correct the model in the configuration, or the id of the servo.",
            )
        state = ServoState(
            servo, control_table(number, firmware, protocol=servo.protocol), firmware
        )
        self.refresh(state)
        return state

    def refresh(self, state: ServoState, names: Iterable[str] | None = None) -> None:
        """Read its registers again, all that matter or these.

        Raises:
            ServoSilent, ServoCorrupt, ServoRefused: it does not answer.
        """
        bus = self._buses[state.servo.bus]
        for address, length, items in state.blocks(names):
            state.take(bus.read(state.servo.id, address, length), address, items)
        self._follow_link(state)

    def _follow_link(self, state: ServoState) -> None:
        bus, values = self._buses[state.servo.bus], state.values
        bus.set_link(
            state.servo.id,
            return_delay=values.get("return_delay_time", 250) * 2e-6,
            answers_writes=values.get("status_return_level", 2) == 2,
        )

    def _take_state(self, place: int, state: ServoState) -> None:
        values, health = state.values, self.health[place]
        health.hardware_error = values.get("hardware_error_status", 0)
        if "torque_enable" in values:
            health.torque = bool(values["torque_enable"])
        health.watchdog = values.get("bus_watchdog")
        health.hottest = float(values.get("temperature_limit", math.nan))

    # -------------------------------------------------------------------------------------- reading

    def _prepare(self) -> None:
        measured = [
            Member(place, self._present(place, MEASURED)) for place in range(len(self.states))
        ]
        slow = []
        for wanted in SLOW:
            members = [
                Member(place, items)
                for place in range(len(self.states))
                if (items := self._present(place, wanted))
            ]
            if members:
                slow.append(self._reads(members))
        turn = RoundRobin(slow, self._config.slow_interval)
        self._prepared = _Prepared(self._reads(measured), turn)
        count = len(self.states)
        nothing = np.zeros(count, dtype=np.int64)
        begin = np.full(count, time.monotonic())
        none = np.zeros(count, dtype=np.bool_)
        self.frame = Frame(Stamp.now(), nothing, nothing, nothing, begin, none)
        self.silences = Silences(count)

    def _present(self, place: int, roles: Mapping[str, Sequence[str]]) -> dict[str, Item]:
        table = self.states[place].table
        found = {role: table.first(names) for role, names in roles.items()}
        return {role: item for role, item in found.items() if item is not None}

    def _reads(self, members: Iterable[Member]) -> BlockReads:
        return BlockReads(self._buses, self.states, members, fast=self._config.fast_read)

    def exchange(self) -> Frame:
        """Read every servo, and now and then something that changes slowly.

        Raises:
            ConnectionLost: a port is gone.
        """
        before, prepared = self.frame, self._prepared
        assert before is not None
        assert prepared is not None
        columns = {
            "position": before.position.copy(),
            "velocity": before.velocity.copy(),
            "effort": before.effort.copy(),
        }
        valid = np.zeros(len(before.seen), dtype=np.bool_)
        began = time.monotonic()
        if prepared.measured.read_into(columns, valid):
            prepared.slow.restart()
        ended = time.monotonic()
        middle = 0.5 * (began + ended)
        stamp = Stamp.at(middle)
        seen = np.where(valid, middle, before.seen)
        self.frame = Frame(stamp, **columns, seen=seen, valid=valid)
        self.cycles += 1
        self._look_at_turns(self.frame, before)
        self.silences.broken(valid)
        self.silences.go_on(np.flatnonzero(~valid), began, ended)
        # A servo that was without power says so by its registers, before it is sent anything.
        back = np.flatnonzero(valid & (before.seen < middle - GAP)).tolist()
        for place in back:
            self.health[place].torque = None
        self.read_health(back)
        slow = prepared.slow.due(ended)
        if slow is not None:
            self._read_slow(slow)
            self.placement.keep_what_has_turned()
        return self.frame

    def _look_at_turns(self, frame: Frame, before: Frame) -> None:
        """Find which servos that are back have forgotten turns: they come without torque.

        Of one that does not say so, what it counts may be turns from where it is: it is not back yet.
        """
        back = self.placement.follow(frame)
        if not back:
            return
        torques = self.read_values(back, ["torque_enable"])
        for place in back.keys() - torques.keys():
            frame.take_back(place, before)
        for place, values in torques.items():
            if not values["torque_enable"]:
                self.placement.has_forgotten(place, back[place])

    def _read_slow(self, slow: BlockReads) -> None:
        for items, first, place, data, _, hardware in slow.run():
            if data is not None:
                self.health[place].take(values_of(items, first, data), hardware)

    def read_values(self, places: Iterable[int], names: Iterable[str]) -> dict[int, Values]:
        """Return registers of servos, of each what it has of `names`; who does not answer is left out."""
        roles = {name: (name,) for name in names}
        return {place: values for place, (values, _) in self._read_once(places, roles).items()}

    def read_positions(self, places: Iterable[int]) -> dict[int, int]:
        """Return where servos are now, in counts; who does not answer is left out."""
        found = self._read_once(places, {"position": POSITION})
        return {place: values["position"] for place, (values, _) in found.items()}

    def _read_once(
        self, places: Iterable[int], roles: Mapping[str, Sequence[str]]
    ) -> dict[int, tuple[Values, int]]:
        """Return values by role and error bits of the status, of those that answer once or the other time."""
        missing = [
            Member(place, items) for place in places if (items := self._present(place, roles))
        ]
        found: dict[int, tuple[Values, int]] = {}
        began = time.monotonic()
        for _ in range(2):
            for roles_read, first, place, data, _, hardware in self._reads(missing).run():
                if data is not None:
                    found[place] = values_of(roles_read, first, data), hardware
            missing = [member for member in missing if member.place not in found]
        silent = np.array([member.place for member in missing], dtype=np.int64)
        self.silences.go_on(silent, began, time.monotonic())
        return found

    def learn(self, place: int, values: Values) -> None:
        """Keep what registers of a servo were found to hold, and speak to it accordingly."""
        state = self.states[place]
        known = {name: value for name, value in values.items() if name in state.values}
        if any(state.values[name] != value for name, value in known.items()):
            state.values.update(known)
            self._follow_link(state)

    def read_health(self, places: Iterable[int]) -> frozenset[int]:
        """Read now whether torque is on and what is wrong; return who answered."""
        answered = self._read_once(places, HEALTH)
        for place, (values, status_bits) in answered.items():
            self.health[place].take(values, status_bits)
        return frozenset(answered)

    # -------------------------------------------------------------------------------------- writing

    def write_values(self, wanted: Mapping[int, Values]) -> None:
        """Write registers of several servos, together where they can be; nobody answers.

        What a servo does not have is left out.
        """
        for (bus, _, address, length), by_id in self._together(wanted).items():
            self._buses[bus].sync_write(address, length, by_id)

    def _together(self, wanted: Mapping[int, Values]) -> dict[GroupKey, dict[int, bytes]]:
        together: dict[GroupKey, dict[int, bytes]] = defaultdict(dict)
        for place, values in wanted.items():
            state = self.states[place]
            known = {name: value for name, value in values.items() if state.has(name)}
            for address, data in runs(state.table, known):
                key = (state.servo.bus, state.servo.protocol, address, len(data))
                together[key][state.servo.id] = data
        return together

    def write_from_outside(self, wanted: Mapping[int, Values]) -> None:
        """Write registers of several servos from another thread, which does not wait for the I/O thread.

        What a servo answers meanwhile may collide with it: it is sent several times.
        """
        packets: dict[str, bytes] = defaultdict(bytes)
        for (bus, protocol, address, length), by_id in self._together(wanted).items():
            packets[bus] += PROTOCOLS[protocol].sync_write(address, length, by_id)
        for attempt in range(OUTSIDE_TIMES):
            if attempt:
                time.sleep(OUTSIDE_PAUSE)
            for name, data in packets.items():
                if name in self._buses:
                    self._buses[name].port.write_from_outside(data, OUTSIDE_PAUSE)

    def write_checked(self, place: int, values: Values) -> None:
        """Write registers of one servo one by one, and read them back: EEPROM.

        Raises:
            ServoSilent, ServoCorrupt, ServoRefused: it does not answer, or says no.
        """
        state = self.states[place]
        bus, servo = self._buses[state.servo.bus], state.servo.id
        for address, data in runs(state.table, values):
            bus.write(servo, address, data)
        self.refresh(state, values)
        self.placement.has_other_registers(place)

    def send(self, name: str, places: Sequence[int], counts: Counts) -> None:
        """Write one goal register of servos (n,), prepared at the first use.

        Args:
            name: of the register.
            places: of the servos, always the same for this register and the same first servo.
            counts: (n,).
        """
        assert self._prepared is not None
        key = f"{name} {places[0]}"
        writes = self._prepared.goals.get(key)
        if writes is None:
            writes = self._prepared.goals[key] = list(self._goal_writes(name, places))
        for write, index, item, is_older in writes:
            if is_older:
                taking = [i for i in index.tolist() if self.takes_goals(places[i])]
                if len(taking) < len(index):
                    self.write_values({places[i]: {name: int(counts[i])} for i in taking})
                    continue
            write.run(encoded(counts[index], item.coding).astype(f"<i{item.size}").tobytes())

    def _goal_writes(self, name: str, places: Sequence[int]) -> Iterator[_GoalWrite]:
        by_item: dict[tuple[str, int, Item], list[int]] = defaultdict(list)
        for index, place in enumerate(places):
            state = self.states[place]
            by_item[state.servo.bus, state.servo.protocol, state.table.item(name)].append(index)
        for (bus, _, item), members in by_item.items():
            ids = [self.states[places[index]].servo.id for index in members]
            write = self._buses[bus].write_group(ids, item.address, item.size)
            is_older = any(
                self.states[places[i]].servo.units.model.family.is_older for i in members
            )
            yield _GoalWrite(write, np.array(members), item, is_older)

    def reboot(self, place: int) -> None:
        """Restart a servo; it takes some tenths of a second to answer again."""
        state = self.states[place]
        self._buses[state.servo.bus].reboot(state.servo.id)

    # ------------------------------------------------------------------------------------- figures

    @property
    def remedies(self) -> tuple[str, ...]:
        """What is to be done about the adapters, in words."""
        latencies = [bus.port.latency for bus in self._buses.values()]
        return tuple(latency.remedy for latency in latencies if latency.remedy)

    @property
    def counters(self) -> dict[str, float]:
        """Numbers for diagnostics, of all servos together; what is not known yet is left out."""
        counted = [
            bus.counters(servo.id)
            for servo in self.chain.servos
            if (bus := self._buses.get(servo.bus)) is not None
        ]
        figures = {
            "replies": float(sum(c.replies for c in counted)),
            "timeouts": float(sum(c.timeouts for c in counted)),
            "corrupt": float(sum(c.corrupt for c in counted)),
            "alerts": float(sum(c.alerts for c in counted)),
        }
        voltages = [h.voltage for h in self.health if not math.isnan(h.voltage)]
        temperatures = [h.temperature for h in self.health if not math.isnan(h.temperature)]
        if voltages:
            figures["voltage_min"] = min(voltages)
        if temperatures:
            figures["temperature_max"] = max(temperatures)
        return figures


def _health(servo: ChainServo) -> Health:
    model = servo.units.model
    return Health(protocol=model.family.protocol, errors=model.errors)


def lost(where: str) -> ConnectionLost:
    """Return the error of a chain in which nobody answers any more."""
    return ConnectionLost(
        "no servo answers any more",
        where=where,
        remedy="Is the power of the servos on, and the cable of the first one in place?",
    )
