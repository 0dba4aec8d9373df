"""A Dynamixel driver in this process, simulated servos in their own, and what tests ask of both."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from typing_extensions import override

from crtk_driver_dynamixel import PLUGIN, chain_link, stopping
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Device
from crtk_drivers.engine import Engine, Observer
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import Stamp
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState, Status
from crtk_sim_backends.dynamixel import SIM, RunningSim
from rigs.told_states import ToldStates
from rigs.waiting import LONG, eventually

STOP_TIME = 1.5
"""Seconds, in place of half of one, in which servos stand after a stop, and before a port is closed."""

BOOT_TIME = 0.3
"""Seconds in which a simulated servo answers again after it was switched on."""

COUNT = 2.0 * math.pi / 4096
"""One count of position, rad."""

WEIGHTLESS = ",".join(
    [*(f"{id}:xm540-w270" for id in (1, 2, 3)), *(f"{id}:xm430-w350" for id in (4, 5, 6, 7))]
)
"""Servos of arm6 without gravity: a joint stays where it is without torque."""

PATIENT: Mapping[str, Any] = {
    "sample_timeout": 3.0,
    "open_timeout": 10.0,
    "rate": 100.0,
    "latency_budget": 0.02,
    "silent_timeout": 1.0,
    "slow_interval": 0.05,
    "watchdog": 2.5,
    "stream_timeout": 0.3,
}
"""Configuration in which a busy machine is no fault."""

REGISTERS: Mapping[str, tuple[int, int]] = {
    "return_delay_time": (9, 1),
    "drive_mode": (10, 1),
    "operating_mode": (11, 1),
    "secondary_id": (12, 1),
    "homing_offset": (20, 4),
    "torque_enable": (64, 1),
    "status_return_level": (68, 1),
    "position_p_gain": (84, 2),
    "bus_watchdog": (98, 1),
    "goal_pwm": (100, 2),
    "goal_current": (102, 2),
    "goal_velocity": (104, 4),
    "profile_acceleration": (108, 4),
    "profile_velocity": (112, 4),
    "goal_position": (116, 4),
}
"""Address and size of registers of the X series (e-manual, control table of XM430-W350)."""

EEPROM_END = 64
TORQUE = REGISTERS["torque_enable"][0]

PING, READ, WRITE, REBOOT = 0x01, 0x02, 0x03, 0x08
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ, BULK_READ, FAST_BULK_READ = 0x82, 0x83, 0x8A, 0x92, 0x9A
HARMLESS = {PING, READ, SYNC_READ, FAST_SYNC_READ, BULK_READ, FAST_BULK_READ}


class Write(NamedTuple):
    """What one servo was told to put into its registers."""

    bus: str
    id: int
    address: int
    data: bytes

    def get(self, name: str) -> int | None:
        """Return the value of a register, None if it is not written."""
        address, size = REGISTERS[name]
        at = address - self.address
        if not 0 <= at <= len(self.data) - size:
            return None
        return int.from_bytes(self.data[at : at + size], "little", signed=True)


def writes_of(entry: Mapping[str, Any]) -> Iterator[Write]:
    """Yield the writes of an instruction of protocol 2.0 in a simulator's trace."""
    bus, code, data = entry["bus"], entry["code"], bytes.fromhex(entry["parameters"])
    address = int.from_bytes(data[:2], "little")
    if code == WRITE:
        yield Write(bus, entry["id"], address, data[2:])
    elif code == SYNC_WRITE:
        step = int.from_bytes(data[2:4], "little") + 1
        for at in range(4, len(data), step):
            yield Write(bus, data[at], address, data[at + 1 : at + step])


class TorqueOn(NamedTuple):
    """A servo at the instant at which its torque is switched on, by what was written to it before."""

    bus: str
    id: int
    registers: Mapping[str, int]


def torque_ons(writes: Sequence[Write]) -> list[TorqueOn]:
    """Return each switching on of torque with what had been written until then."""
    known: dict[tuple[str, int], dict[str, int]] = {}
    found = []
    for write in writes:
        registers = known.setdefault((write.bus, write.id), {})
        was_on = registers.get("torque_enable", 0)
        for name in REGISTERS:
            value = write.get(name)
            if value is not None:
                registers[name] = value
        if registers.get("torque_enable", 0) and not was_on:
            found.append(TorqueOn(write.bus, write.id, dict(registers)))
    return found


class Log(Observer):
    """Everything that the driver told, in order."""

    def __init__(self) -> None:
        self.statuses: list[Status] = []
        self.refusals: list[CommandRefused] = []

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        self.statuses.append(status)

    @override
    def command_refused(self, refusal: CommandRefused) -> None:
        self.refusals.append(refusal)


class DynamixelBench:
    """The two of them."""

    def __init__(self, sim: RunningSim, session: Session) -> None:
        self.sim = sim
        self.session = session
        self.engine = session.engine
        self.device: Any = getattr(session.engine.device, "inner", session.engine.device)
        self.arm: Any = LocalDevice(session)
        self.log = Log()
        self.engine.add_observer(self.log)
        self._told = {engine: ToldStates(engine) for engine in session.engines}

    # The driver

    @property
    def status(self) -> Status:
        """Of the arm."""
        return self.engine.status

    def until_connected(self) -> None:
        """Wait until arm and gripper are connected and read."""
        for engine in self.session.engines:
            eventually(lambda e=engine: e.connected and e.has_sample, f"connected: {engine.status}")

    def until_state(self, state: str, detail: str = "", engine: Engine | None = None) -> str:
        """Wait for an operating state of the arm, or of another engine, and return why it is in it."""
        return self._told[engine or self.engine].detail(OperatingState(state), detail)

    def enable(self) -> None:
        """Enable arm and gripper."""
        self.arm.enable(timeout=LONG)
        if "gripper" in self.session.children:
            self.arm.gripper.enable(timeout=LONG)

    def reset(self) -> None:
        """No fault, arm and gripper ENABLED, all joints at zero and at rest."""
        self.sim.control.clear()
        self.until_connected()
        for device in (self.arm, self.arm.gripper):
            if not device.is_enabled():
                device.enable(timeout=LONG)
            device.hold()
        assert self.arm.move_jp(np.zeros(6)).wait(LONG)
        self.until_still()

    def cycles(self, count: int = 5) -> None:
        """Wait for some cycles."""
        goal = self.arm.health().samples + count
        eventually(lambda: self.arm.health().samples >= goal, f"{count} samples")

    def stream(
        self, name: str, value: Any, until: Callable[[], object], device: Any = None
    ) -> None:
        """Send one value of a stream over and over until something has happened.

        What is refused because the driver was held up is followed by another.
        """
        deadline = time.monotonic() + LONG
        while not until():
            assert time.monotonic() < deadline, f"{name} never did it"
            try:
                getattr(device or self.arm, name)(value)
            except CommandRefused as refusal:
                if refusal.reason not in (Reason.NOT_MEASURED, Reason.TOO_OLD):
                    raise
            time.sleep(0.01)

    # The servos

    def servos(self, bus: int = 1) -> dict[int, dict[str, Any]]:
        """Return what the simulator says of each servo of a bus, by id."""
        prefix = f"bus{bus}/"
        found = self.sim.control.outputs()
        return {int(n.removeprefix(prefix)): s for n, s in found.items() if n.startswith(prefix)}

    def angles(self, bus: int = 1) -> np.ndarray:
        """Return the angles of all servos of a bus, rad."""
        return np.array([servo["angle"] for servo in self.servos(bus).values()])

    def torques(self, bus: int = 1) -> list[bool]:
        """Return which servos of a bus have torque."""
        return [servo["torque"] for servo in self.servos(bus).values()]

    def stands(self) -> bool:
        """Whether no servo turns."""
        return all(abs(servo["velocity"]) < 5e-3 for servo in self.sim.control.outputs().values())

    def until_still(self) -> None:
        """Wait until no servo turns."""
        eventually(self.stands, "the servos stand")

    def watch(self, seconds: float) -> float:
        """Return the largest speed of a servo within `seconds`, rad/s."""
        fastest, end = 0.0, time.monotonic() + seconds
        while time.monotonic() < end:
            found = self.sim.control.outputs().values()
            fastest = max(fastest, *(abs(servo["velocity"]) for servo in found))
            time.sleep(0.01)
        return fastest

    @contextmanager
    def nothing_moves(self, counts: float = 3.0, ids: Sequence[int] = ()) -> Iterator[None]:
        """The servos (or those with `ids`) must be at the end where they were at the beginning."""
        before = self.servos()
        yield
        after = self.servos()
        moved = {
            id: round((after[id]["angle"] - before[id]["angle"]) / COUNT, 1)
            for id in ids or before
            if abs(after[id]["angle"] - before[id]["angle"]) > counts * COUNT
        }
        assert not moved, f"servos moved by so many counts: {moved}"

    def place(self, **angles: float) -> None:
        """Put joints somewhere by hand: ``joint_2=0.3`` for that of servo 2, rad of its horn."""
        for name, angle in angles.items():
            place(self.sim, int(name.removeprefix("joint_")), angle)

    # The wire

    def mark(self) -> int:
        """Return where the trace of received instructions stands."""
        return int(self.sim.control.status()["instructions"])

    def trace(self, mark: int = 0) -> list[dict[str, Any]]:
        """Return the instructions since `mark`."""
        found: list[dict[str, Any]] = self.sim.control.trace(after=mark)
        return found

    def writes(self, mark: int = 0) -> list[Write]:
        """Return what was written since `mark`, servo by servo."""
        return [write for entry in self.trace(mark) for write in writes_of(entry)]

    def written(self, name: str, mark: int = 0) -> list[tuple[int, int]]:
        """Return id and value of each write of a register since `mark`."""
        values = ((write.id, write.get(name)) for write in self.writes(mark))
        return [(id, value) for id, value in values if value is not None]

    def eeprom_writes(self, mark: int = 0) -> list[Write]:
        """Return what was written into EEPROM since `mark`."""
        return [write for write in self.writes(mark) if write.address < EEPROM_END]


def place(sim: RunningSim, id: int, angle: float = 0.0, bus: int = 1) -> None:
    """Put the joint of a servo somewhere by hand, rad of its horn from the middle."""
    sim.control.call("place", id=id, angle=angle, bus=bus)


def set_upright(sim: RunningSim) -> None:
    """End all faults, with torque off (by a power cycle if need be) and every joint in the middle."""
    sim.control.clear()
    servos = sim.control.outputs()
    if any(servo["torque"] or abs(servo["angle"]) > math.pi for servo in servos.values()):
        for bus in range(1, len(sim.ttys) + 1):
            sim.control.inject("power_off", bus=bus)
        _place_all(sim, servos)  # a servo that starts counts from the turn that it is in
        sim.control.clear()
        started = sim.control.status()["time"]
        eventually(lambda: sim.control.status()["time"] > started + BOOT_TIME, "servos started")
    _place_all(sim, servos)


def _place_all(sim: RunningSim, servos: Iterable[str]) -> None:
    """Put joints into the middle, by the names of their servos."""
    for name in servos:
        number, id = name.removeprefix("bus").split("/")
        place(sim, int(id), bus=int(number))


def arm_values(arm: str = "arm6", **values: Any) -> dict[str, Any]:
    """Return configuration values of a packaged arm for a busy machine."""
    return {**PATIENT, "arm": arm, **values}


def configuration(sim: RunningSim, values: Mapping[str, Any]) -> DynamixelConfig:
    """Return the driver's configuration for a running simulator."""
    config = PLUGIN.sim_config(load(PLUGIN.config, from_values(dict(values))), sim)
    assert isinstance(config, DynamixelConfig)
    return config


def sim_for(values: Mapping[str, Any], **options: Any) -> RunningSim:
    """Start simulated servos that suit configuration values."""
    config = load(PLUGIN.config, from_values(dict(values)))
    return SIM.spawn(**{"trace_size": 20_000, **PLUGIN.sim_options(config), **options})


@contextmanager
def lenient() -> Iterator[None]:
    """Let stops take longer."""
    with patch.object(stopping, "STOP_TIME", STOP_TIME):
        yield


@contextmanager
def patient() -> Iterator[None]:
    """Let servos be late when a device is opened that nobody opens once more."""
    with lenient(), patch.object(chain_link, "PATIENCE", 1.0):
        yield


@contextmanager
def driver_at(
    sim: RunningSim, values: Mapping[str, Any], *, start: bool = True
) -> Iterator[DynamixelBench]:
    """A driver for simulated servos that run already."""
    with lenient():
        session = Session(PLUGIN, configuration(sim, values))
        bench = DynamixelBench(sim, session)
        try:
            if start:
                session.start()
                bench.until_connected()
            yield bench
        finally:
            bench.arm.close()


@contextmanager
def opened(sim: RunningSim, values: Mapping[str, Any], **more: Any) -> Iterator[Device]:
    """The device alone, opened in this thread as the I/O thread would."""
    with patient():
        device = PLUGIN.create(configuration(sim, {**values, **more}))
        try:
            device.open(time.monotonic() + LONG)
            yield device
        finally:
            device.close()


@contextmanager
def dynamixel_bench(
    values: Mapping[str, Any] | None = None, *, start: bool = True, **options: Any
) -> Iterator[DynamixelBench]:
    """Simulated servos and a driver that is connected to them."""
    chosen = arm_values() if values is None else values
    with sim_for(chosen, **options) as sim, driver_at(sim, chosen, start=start) as bench:
        yield bench
