"""A simulated CANopen drive: frames in, frames out, no I/O and no clock of its own."""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass, field, replace
from typing import Final, TypeAlias

from crtk_sim_backends.canopen.aborts import Abort, SdoAbort
from crtk_sim_backends.canopen.axis import Axis
from crtk_sim_backends.canopen.defects import AxisDefects
from crtk_sim_backends.canopen.dictionary import Key, Object, ObjectDictionary
from crtk_sim_backends.canopen.eds import electronic_data_sheet
from crtk_sim_backends.canopen.emcy import Emergency
from crtk_sim_backends.canopen.fitting import Likeness
from crtk_sim_backends.canopen.nmt import (
    ENTERS,
    INITIALISING,
    OPERATIONAL,
    PRE_OPERATIONAL,
    STOPPED,
    Command,
    Heartbeats,
    NmtState,
    command_for,
)
from crtk_sim_backends.canopen.objects import (
    LOAD,
    MODES,
    MOST_AXES,
    PDOS,
    SAVE,
    SYNC_TIMEOUT,
    axis,
    communication,
)
from crtk_sim_backends.canopen.pdo import ProcessData
from crtk_sim_backends.canopen.personality import PERSONALITIES, Personality
from crtk_sim_backends.canopen.plant import Motor, MotorConfig
from crtk_sim_backends.canopen.sdo import SdoServer

Frame: TypeAlias = tuple[int, bytes]  # 11-bit identifier, up to 8 bytes

CAN_PASSIVE: Final = 0x8120
HEARTBEAT_LOST: Final = 0x8130
BUS_OFF: Final = 0x8140

_CONTROL_PERIOD: Final = 0.001  # s
_TICK: Final = 0.004  # s between calls of `on_timer` while an axis moves or is powered
_SYNC_TICK: Final = 0.02  # the same while SYNC wakes the drive
_LONGEST_GAP: Final = 0.25  # s; what a longer pause brings is left out
_SHORTEST_TIMEOUT: Final = 0.001  # s that a supervision of SYNC can have
_SYNC_TIMEOUT: Final = 0.5  # s, of a drive that is like a real one
_STALL: Final = 0.05  # s; who wakes the drive so late has been stalled, and not the master
_NOT_STORED: Final = (0x1003, 0x1010, 0x1011, 0x2000)
_COMMANDS: Final = (0x6040, 0x6060)  # which no drive stores
_NEVER: Final = float("inf")


@dataclass(frozen=True)
class DriveConfig:
    """What a simulated drive is.

    Attributes:
        motors: what its axes move, one entry for each axis.
        serial: serial number in 1018, None for the node-ID.
        personality: make of the drive.
        modes: of operation that it has (6502).
        pdos: of each direction that it has.
        like: the real drive that it is like; its objects are those of that one's EDS.
        defects: of its axes.
    """

    motors: tuple[MotorConfig, ...] = (MotorConfig(),)
    serial: int | None = None
    personality: Personality = PERSONALITIES["standard"]
    modes: frozenset[int] = frozenset(MODES)
    pdos: int = PDOS
    like: Likeness | None = None
    defects: AxisDefects | None = None


@dataclass
class DriveFaults:
    """What is wrong with the drive on the bus; changed while it runs.

    Attributes:
        silent: it neither hears nor says anything, as with its cable pulled out; it runs on.
        off: its electronics have no power.
        no_sdo: SDO requests are not answered.
        no_heartbeat: heartbeats are not sent.
        no_tpdo: TPDOs are not sent.
        tpdo_delay: TPDOs are sent so many seconds late.
        sdo_delay: SDO answers are sent so many seconds late.
        sdo_aborts: objects whose accesses are refused: their abort codes.
    """

    silent: bool = False
    off: bool = False
    no_sdo: bool = False
    no_heartbeat: bool = False
    no_tpdo: bool = False
    tpdo_delay: float = 0.0
    sdo_delay: float = 0.0
    sdo_aborts: dict[Key, int] = field(default_factory=dict)


def _without(entry: Object, lacks: Container[int | Key]) -> Object:
    """The object as others see it: without the entries that the make has not."""
    kept = {
        sub: variable for sub, variable in entry.entries.items() if (entry.index, sub) not in lacks
    }
    if 0 in kept and len(kept) < len(entry.entries):
        kept[0] = replace(kept[0], default=max(kept))
    return replace(entry, entries=kept)


def drive_objects(config: DriveConfig, node_id: int) -> tuple[list[Object], list[Object]]:
    """Objects of a drive that can be reached, and those that the machine needs besides.

    They are those of its EDS, or the machine's with what its personality has otherwise.
    """
    personality = config.personality
    serial = node_id if config.serial is None else config.serial
    if config.like is not None:
        return config.like.objects_of(serial), list(config.like.hidden)
    axes = len(config.motors)
    objects = list(
        communication(axes, personality.vendor, personality.product, personality.revision, serial,
                      personality.device.encode(), b"1.0", b"1.0", config.pdos)
    )  # fmt: skip
    for number in range(axes):
        objects += axis(number, config.modes)
    for place, entry in enumerate(objects):
        for index, sub, value in personality.defaults:
            if entry.index == index:
                changed = replace(entry.entries[sub], default=value)
                entry = objects[place] = replace(entry, entries={**entry.entries, sub: changed})
        if entry.index in personality.constant:
            fixed = {sub: replace(each, access="const") for sub, each in entry.entries.items()}
            objects[place] = replace(entry, entries=fixed)
    lacks = personality.lacks
    reached = [_without(entry, lacks) for entry in objects if entry.index not in lacks]
    reached += personality.adds
    return sorted(reached, key=lambda entry: entry.index), objects


def eds_of(config: DriveConfig) -> str:
    """EDS of the drives with this configuration, the same for all node-IDs."""
    if config.like is not None:
        return config.like.sheet.text
    objects, _ = drive_objects(replace(config, serial=0), 0)
    make = config.personality
    return electronic_data_sheet(objects, make.vendor, make.product, make.revision, make.device)


class Drive:
    """One node. Give it every frame of the bus and a call when its timer is due.

    Its boot-up message comes from the first call. All times are those of one monotonic clock, s.

    Args:
        node_id: 1 to 127.
        config: what it is.
    """

    def __init__(self, node_id: int, config: DriveConfig | None = None) -> None:
        self.config = config or DriveConfig()
        if not 1 <= node_id <= 127 or not 1 <= len(self.config.motors) <= MOST_AXES:
            raise ValueError(f"no drive: node-ID {node_id}, {len(self.config.motors)} axes")
        self.node_id = node_id
        self.faults = DriveFaults()
        self.state = INITIALISING
        self.next_timer = 0.0
        like = self.config.like
        reached, hidden = drive_objects(self.config, node_id)
        self.dictionary = ObjectDictionary(reached, node_id, hidden)
        self.dictionary.ignored.update(self.config.personality.ignores)
        self.emergency = Emergency(self.dictionary)
        self.heartbeats = Heartbeats(self.dictionary, self._heartbeat_lost, self._heartbeat_back)
        self.pdos = ProcessData(
            self.dictionary,
            self.emergency,
            lambda: self.state is OPERATIONAL,
            keeps_no_rtr=self.config.personality.keeps_no_rtr,
        )
        self.axes = [
            Axis(
                number,
                self.dictionary,
                self.emergency,
                Motor(motor),
                like.modes[number] if like else self.config.modes,
                self.config.personality,
                self.config.defects,
                like.stand_ins if like else None,
            )
            for number, motor in enumerate(self.config.motors)
        ]
        self._sdo = SdoServer(
            self.dictionary,
            refuse=self._refuse,
            block=0 if self.config.personality.no_block else 127,
        )
        self._time: float | None = None  # until which the axes have been computed
        self._last_call = 0.0
        self._boot_at = 0.0
        self._last_sync: float | None = None
        self.acts = False  # SYNC has come, and `act` has not been called
        self._late: list[tuple[float, Frame]] = []  # frames that wait for their time
        self.interests: frozenset[int] = frozenset()
        self._note_interests()
        self._connect()

    def _connect(self) -> None:
        od = self.dictionary
        od.guards[0x1010] = self._guard_store
        od.guards[0x1011] = self._guard_restore
        od.written[0x1010] = lambda _: self._store()
        od.written[0x1011] = lambda _: self._restore()
        od.values[0x1021, 0] = b""
        od.live[0x1021, 0] = lambda: eds_of(self.config).encode()

    # Calls from the bus

    def on_frame(self, identifier: int, data: bytes, now: float) -> list[Frame]:
        """Hear a frame of the bus; the frames that the drive sends because of it, or until now.

        Frames whose identifier is not in `interests` need not be given to it. With SYNC the samples are sent
        first, and what it makes valid is carried out by `act`, or else by the next frame or timer.
        """
        frames = self.act(now) if self.acts else []
        frames += self._advance(now)
        if self.faults.silent or self.faults.off or self.state is INITIALISING:
            return self._leave(frames, now)
        if identifier == self._sync:
            frames += self._on_sync(data, now)
            if self.next_timer > now and not self._has_events:
                self.next_timer = min(self.next_timer, now + _SYNC_TICK)
                return frames
        elif pdo := self.pdos.receiving.get(identifier):
            if self.state is OPERATIONAL and self.pdos.on_rpdo(pdo, data, now):
                self._process()
        elif identifier == 0x600 + self.node_id:
            if self.state is not STOPPED and not self.faults.no_sdo:
                answers = self._sdo.on_request(data, now)
                frames += [(0x580 + self.node_id, answer) for answer in answers]
                self._process()
                self._note_interests()
        elif identifier == 0:
            if command := command_for(data, self.node_id):
                frames += self._on_command(command, now)
        elif 0x700 < identifier <= 0x77F:
            self.heartbeats.on_heartbeat(identifier - 0x700, now)
        return self._leave(frames + self._events(now), now)

    def keep(self, identifier: int, data: bytes, now: float) -> bool:
        """Keep an RPDO until SYNC, if that and its deadline are all it changes: the quick part of `on_frame`.

        Returns:
            Whether that was all; otherwise give the frame to `on_frame`.
        """
        pdo = self.pdos.receiving.get(identifier)
        if pdo is None or not pdo.plain or len(data) != pdo.layout.size or self.acts:
            return False
        if pdo.event and pdo.deadline is None:
            return False  # the first one, or one that ends an error
        if self.state is OPERATIONAL and not self.faults.silent:
            pdo.received = data
            if pdo.event:
                pdo.deadline = now + pdo.event
        return True

    def act(self, now: float) -> list[Frame]:
        """Carry out what the last SYNC has made valid, RPDOs and targets; the frames that follow from it."""
        if not self.acts:
            return []
        self.acts = False
        self.pdos.apply_received()
        for unit in self.axes:
            unit.process(sync=True)
        return self._leave(self._events(now), now) if self._has_events else []

    def on_timer(self, now: float) -> list[Frame]:
        """Do what is due; the frames that the drive sends."""
        frames = self.act(now) + self._advance(now)
        if self.state is not INITIALISING and not self.faults.off:
            answers = self._sdo.expire(now)
            frames += [(0x580 + self.node_id, answer) for answer in answers]
            self.heartbeats.check(now)
            self.pdos.check_deadlines(now)
            frames += self._events(now)
        return self._leave(frames, now)

    def reset(self, now: float) -> None:
        """Lose everything and boot again, as after a short loss of the electronics' power."""
        self._begin_boot(now, self.dictionary.variables)

    def bus_changed(self, *, off: bool, was_off: bool, passive: bool) -> None:
        """Take note of the state of the CAN controller: bus-off is a lost connection (6007)."""
        if off and not was_off:
            for unit in self.axes:
                unit.connection_lost(BUS_OFF)
        elif was_off and not off:
            self.emergency.once(BUS_OFF)
        if passive:
            self.emergency.begin(CAN_PASSIVE)
        else:
            self.emergency.end(CAN_PASSIVE)

    def switch(self, *, on: bool, now: float) -> None:
        """Switch the power of the electronics; with it the drive boots."""
        self.faults.off = not on
        self.reset(now)

    def _note_interests(self) -> None:
        """Collect the identifiers that mean something to this node."""
        self._sync = self.dictionary[0x1005, 0] & 0x7FF
        interests = frozenset((0, self._sync, 0x600 + self.node_id)).union(
            self.pdos.receiving, self.heartbeats.monitored
        )
        if interests != self.interests:
            self.interests = interests

    # Network management

    def _on_command(self, command: Command, now: float) -> list[Frame]:
        if command is Command.RESET_NODE:
            self._begin_boot(now, self.dictionary.variables)
        elif command is Command.RESET_COMMUNICATION:
            for unit in self.axes:
                unit.connection_lost(HEARTBEAT_LOST)
            self._begin_boot(now, self.dictionary.keys_within(0x1000, 0x1FFF), whole=False)
        else:
            self._enter(ENTERS[command])
        return []

    def _begin_boot(self, now: float, keys: Iterable[Key], *, whole: bool = True) -> None:
        self.state = INITIALISING
        self._boot_at = now + self.config.personality.boot
        self._sdo.reset()
        self._last_sync = None
        self._late.clear()
        if whole:
            self.emergency.reset()
        self.dictionary.reset(keys)
        if whole:
            for unit in self.axes:
                unit.reset()
        self.pdos.rebuild()
        self.heartbeats.reset(self._boot_at)
        self._note_interests()

    def _enter(self, state: NmtState) -> None:
        if state is self.state:
            return
        self.state = state
        self._last_sync = None
        if state is OPERATIONAL:
            self.pdos.begin()
        elif state is STOPPED:
            self._sdo.reset()
            for unit in self.axes:
                unit.connection_lost(HEARTBEAT_LOST)
            self.emergency.drop()

    def _heartbeat_lost(self, node: int) -> None:
        self.emergency.begin(HEARTBEAT_LOST, bytes((node,)), 0x700 + node)
        for unit in self.axes:
            unit.connection_lost(HEARTBEAT_LOST)
        behaviour = self.dictionary[0x1029, 1]
        if behaviour == 0 and self.state is OPERATIONAL:
            self._enter(PRE_OPERATIONAL)
        elif behaviour == 2:
            self._enter(STOPPED)

    def _heartbeat_back(self, node: int) -> None:
        self.emergency.end(HEARTBEAT_LOST, 0x700 + node)

    # Process data

    def _on_sync(self, data: bytes, now: float) -> list[Frame]:
        if self.state is not OPERATIONAL or not self.pdos.check_sync(data):
            return []
        for unit in self.axes:
            unit.sync_period = now - (self._last_sync or now)
        self._last_sync = now
        self.acts = True
        return self.pdos.on_sync(data[0] if data else None)

    @property
    def _has_events(self) -> bool:
        """Whether more than synchronous TPDOs may have to be sent."""
        faults = self.faults
        return bool(
            self.emergency.waiting
            or self.pdos.event_driven
            or self._late
            or faults.no_tpdo
            or faults.tpdo_delay
        )

    def _process(self) -> None:
        for unit in self.axes:
            unit.process()

    def _check_sync(self, silence: float) -> None:
        timeout = _SYNC_TIMEOUT if self.config.like else self.dictionary[SYNC_TIMEOUT] / 1000
        if timeout and silence > timeout:
            self._last_sync = None
            for unit in self.axes:
                unit.sync_lost()

    # Parameters in non-volatile memory

    def _guard_store(self, sub: int, value: int) -> None:
        if value != SAVE:
            raise SdoAbort(Abort.STORE)
        if any(unit.powered for unit in self.axes):
            raise SdoAbort(Abort.DEVICE_STATE)

    def _guard_restore(self, sub: int, value: int) -> None:
        if value != LOAD:
            raise SdoAbort(Abort.STORE)

    def _store(self) -> None:
        od = self.dictionary
        od[0x1010, 1] = 1
        od.stored = {
            key: od.values[key]
            for key, variable in od.variables.items()
            if variable.access == "rw"
            and key[0] not in _NOT_STORED
            and not (key[0] >= 0x6000 and 0x6000 + key[0] % 0x800 in _COMMANDS)
        }

    def _restore(self) -> None:
        self.dictionary[0x1011, 1] = 1
        self.dictionary.stored = {}  # the defaults come back with the next reset

    def _refuse(self, key: Key, access: str) -> None:
        code = self.faults.sdo_aborts.get(key)
        if code is not None:
            raise SdoAbort(code)

    # Time

    def _advance(self, now: float) -> list[Frame]:
        """Compute the axes until now; the boot-up message when its time has come."""
        if self._time is None:
            self._begin_boot(now - self.config.personality.boot, ())
            self._time = self._last_call = now
        if now - self._last_call > _STALL and now - self.next_timer > _STALL:
            self._forgive(now - self._last_call)
        self._last_call = now
        if self._time + _CONTROL_PERIOD <= now + 1e-9:
            self._time = self._compute(self._time, now)
        if self._last_sync is not None and now - self._last_sync > _SHORTEST_TIMEOUT:
            self._check_sync(now - self._last_sync)
        if self.state is INITIALISING and now >= self._boot_at and not self.faults.off:
            self.state = PRE_OPERATIONAL
            return [(0x700 + self.node_id, b"\0")]
        return []

    def _compute(self, then: float, now: float) -> float:
        """Compute the axes in control periods from `then` on; return until when."""
        then = max(then, now - _LONGEST_GAP)
        if all(unit.idle for unit in self.axes):
            then = max(then, now - _CONTROL_PERIOD)
        while then + _CONTROL_PERIOD <= now + 1e-9:
            then += _CONTROL_PERIOD
            for unit in self.axes:
                if not unit.idle:
                    unit.step(_CONTROL_PERIOD)
        return then

    def _forgive(self, seconds: float) -> None:
        """Extend what the master has to keep: what it sent in time has not been heard yet."""
        self.heartbeats.extend(seconds)
        self.pdos.extend(seconds)
        if self._last_sync is not None:
            self._last_sync += seconds

    def _events(self, now: float) -> list[Frame]:
        """Heartbeat, event-driven TPDOs and EMCY that are due."""
        frames: list[Frame] = []
        if self.state is INITIALISING:
            return frames
        if self.state is not STOPPED:
            frames += self.emergency.take(now)
        if self.state is OPERATIONAL:
            frames += self.pdos.on_events(now)
        if self.heartbeats.produce(now) and not self.faults.no_heartbeat:
            frames.append((0x700 + self.node_id, bytes((self.state,))))
        return frames

    def _leave(self, frames: list[Frame], now: float) -> list[Frame]:
        """Send what may leave now: everything, unless there are faults."""
        faults = self.faults
        if faults.tpdo_delay or faults.sdo_delay or faults.no_tpdo or self._late:
            frames = self._held_back(frames, now)
        self.next_timer = self._next_timer(now)
        return [] if faults.silent or faults.off else frames

    def _held_back(self, frames: list[Frame], now: float) -> list[Frame]:
        tpdos = {pdo.identifier for pdo in self.pdos.transmitting}
        for identifier, data in frames:
            delay = 0.0
            if identifier in tpdos:
                if self.faults.no_tpdo:
                    continue
                delay = self.faults.tpdo_delay
            elif identifier == 0x580 + self.node_id:
                delay = self.faults.sdo_delay
            self._late.append((now + delay, (identifier, data)))
        due = [frame for time, frame in self._late if time <= now]
        self._late = [entry for entry in self._late if entry[0] > now]
        return due

    def _next_timer(self, now: float) -> float:
        if self.faults.off:
            return _NEVER
        if self.state is INITIALISING:
            return self._boot_at
        times = [self.heartbeats.next_timer, self._sdo.deadline, self.pdos.next_timer]
        if self.state is not STOPPED:
            times.append(self.emergency.next_timer)
        times += [time for time, _ in self._late]
        if not all(unit.idle for unit in self.axes):
            times.append(now + (_TICK if self._last_sync is None else _SYNC_TICK))
        return min((time for time in times if time is not None), default=_NEVER)
