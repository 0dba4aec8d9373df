"""What the tools do: find servos, tell how a chain is doing, calibrate it, write its limits. They print."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import yaml
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from crtk_driver_dynamixel.bus import Bus
from crtk_driver_dynamixel.calibration import (
    Calibration,
    configured_calibration,
    save_calibration,
)
from crtk_driver_dynamixel.calibration import calibrate as calibration_of
from crtk_driver_dynamixel.chain_link import ChainLink
from crtk_driver_dynamixel.config import MAIN_BUS, BusConfig, DynamixelConfig
from crtk_driver_dynamixel.joints import Chain
from crtk_driver_dynamixel.models import OperatingMode, model_numbered
from crtk_driver_dynamixel.own_limits import OwnLimit, own_limits
from crtk_driver_dynamixel.replies import ServoCorrupt, ServoSilent
from crtk_driver_dynamixel.tool_options import (
    BAUDS,
    IDS,
    CalibrateOptions,
    InfoOptions,
    LimitsOptions,
    ScanOptions,
    numbers,
)
from crtk_driver_dynamixel.turns import Turns, TurnsFile
from crtk_drivers.errors import ConfigError, ConnectionFailed, CrtkError
from crtk_drivers.kit.serial_port import SerialPort
from crtk_drivers.kit.serial_server import parse_address

TABLE_START: Final = 3
"""Bytes of model number and firmware, with which every table of protocol 1.0 begins."""

_UNKNOWN: Final = "unknown model"

_OUT = Console(highlight=False)


class Found(NamedTuple):
    """One servo that answered."""

    bus: str
    baud: int
    protocol: int
    id: int
    number: int
    firmware: int

    @property
    def is_known(self) -> bool:
        """Whether its model is one of those that the driver knows."""
        return not self.model.startswith(_UNKNOWN)

    @property
    def model(self) -> str:
        """Its model; the number if that is not known."""
        try:
            return model_numbered(self.number).name
        except ConfigError:
            return f"{_UNKNOWN} {self.number}"


# ------------------------------------------------------------------------------------------------ scan


def scan(config: DynamixelConfig, options: ScanOptions) -> int:
    """Ask every id at every rate, and print who answers."""
    ids = numbers(options.ids, IDS.start, IDS.stop - 1)
    protocols = numbers(options.protocols, 1, 2)
    found: list[Found] = []
    for name in config.buses:
        given = config.bus(name)
        bauds = {"all": list(BAUDS), "set": [given.baud]}.get(options.bauds)
        if parse_address(given.port):
            bauds = [given.baud]  # a server has a rate of its own
        found += _scan(
            name, given, bauds or numbers(options.bauds, 9600, 10_500_000), protocols, ids
        )
    _OUT.print(_found_table(found) if found else _nobody(config))
    if options.out and found:
        _write(Path(options.out), found, config)
    return 0 if found else 1


def _scan(
    name: str, given: BusConfig, bauds: Sequence[int], protocols: Sequence[int], ids: Sequence[int]
) -> list[Found]:
    found = []
    with Progress(console=_OUT, transient=True) as progress:
        task = progress.add_task(name, total=len(bauds) * len(protocols) * len(ids))
        for one in scan_bus(name, given.port, bauds, protocols, ids):
            if isinstance(one, Found):
                found.append(one)
                text = f"{name}: {one.model} with id {one.id} at {one.baud} bit/s"
                progress.console.print(text, markup=False, soft_wrap=True)
            else:
                progress.update(task, description=f"{name} {one} bit/s", advance=1)
    return sorted(found, key=lambda one: (one.baud, one.id))


def scan_bus(
    name: str, port: str, bauds: Sequence[int], protocols: Sequence[int], ids: Sequence[int]
) -> Iterator[Found | int]:
    """Yield every servo that answers, and the rate after each id that was asked.

    Where one has answered, those that have not are asked twice more: an answer may be lost.

    Raises:
        ConnectionFailed: the port cannot be opened.
    """
    with closing(Bus(SerialPort(port, bauds[0]))) as bus:
        bus.open()
        for baud in bauds:
            bus.set_baud(baud)
            silent = []
            for protocol in protocols:
                for id in ids:
                    one = _ask(bus, name, baud, protocol, id, attempts=1)
                    if one is not None:
                        yield one
                    else:
                        silent.append((protocol, id))
                    yield baud
            if len(silent) < len(protocols) * len(ids):
                again = (_ask(bus, name, baud, protocol, id, attempts=2) for protocol, id in silent)
                yield from (one for one in again if one is not None)


def _ask(bus: Bus, name: str, baud: int, protocol: int, id: int, attempts: int) -> Found | None:
    bus.set_link(id, protocol=protocol)
    try:
        told = bus.ping(id, attempts=attempts)
        number, firmware = told.model, told.firmware
        if protocol == 1:
            data = bus.read(id, 0, TABLE_START)
            number, firmware = int.from_bytes(data[:2], "little"), data[2]
    except (ServoSilent, ServoCorrupt):
        return None
    return Found(name, baud, protocol, id, number, firmware)


def _found_table(found: Sequence[Found]) -> Table:
    table = Table("bus", "bit/s", "id", "model", "firmware", "protocol", box=None, pad_edge=False)
    for one in found:
        numbers = (one.baud, one.id, one.model, one.firmware, one.protocol)
        table.add_row(one.bus, *map(str, numbers))
    return table


def _nobody(config: DynamixelConfig) -> str:
    ports = ", ".join(config.bus(name).port for name in config.buses)
    return (
        f"Nobody answers on {ports}.\nIs the power of the servos on (USB does not feed them)? Is the cable "
        "in the first one? Two servos with one id disturb each other: connect them one at a time."
    )


def _write(path: Path, found: Sequence[Found], config: DynamixelConfig) -> None:
    """Write a configuration to start from; an existing file is left alone."""
    buses: dict[str, dict[str, object]] = {}
    joints: dict[str, dict[str, object]] = {}
    for one in found:
        known = {} if one.bus == MAIN_BUS else {"bus": one.bus}
        given: dict[str, object] = {"id": one.id, "model": one.model, **known}
        if one.protocol == 1:
            given["protocol"] = 1
        buses[one.bus] = {"port": config.bus(one.bus).port, "baud": one.baud}
        joints[f"joint_{len(joints) + 1}"] = given
    head = "# Found by crtk-driver dynamixel scan. Name the joints and give their ranges: docs/dynamixel.md\n"
    text = head + yaml.safe_dump({"buses": buses, "joints": joints}, sort_keys=False)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise ConfigError(
            f"cannot be written: {error.strerror}", where=str(path), remedy="Give a new name."
        ) from error
    _OUT.print(f"written: {path}", markup=False, soft_wrap=True)


# ------------------------------------------------------------------------------------------------ info


def info(config: DynamixelConfig, options: InfoOptions) -> int:
    """Print every servo of the chain, and how fast they can be read. Nothing is written to them."""
    calibration: Calibration | None = None
    notes: list[CrtkError] = []
    try:
        calibration = configured_calibration(config.calibration)
    except ConfigError as error:
        notes.append(error)
    with _opened(config, calibration, reads_only=True) as link:
        try:
            assert link.frame is not None
            link.placement.find(link.states, link.frame, link.address)
        except ConnectionFailed as error:
            notes.append(error)
        began = time.monotonic()
        for _ in range(options.cycles):
            link.exchange()
        lasted = time.monotonic() - began
        _OUT.print(_chain_table(link))
        for note in notes:
            _OUT.print(f"rad is not where the joints are: {note}", markup=False, soft_wrap=True)
        _OUT.print(f"{options.cycles / lasted:.0f} readings a second of all {len(link.states)}")
        for remedy in link.remedies:
            _OUT.print(f"latency timer: {remedy}", markup=False, soft_wrap=True)
    return 0


def _chain_table(link: ChainLink) -> Table:
    frame, chain = link.frame, link.chain
    assert frame is not None
    link.read_health(range(len(chain.servos)))
    positions = chain.scaling.position.to_si(frame.position)
    columns = ("joint", "id", "model", "firmware", "mode", "torque", "rad", "count", "error")
    table = Table(*columns, box=None, pad_edge=False)
    for place, (servo, state) in enumerate(zip(chain.servos, link.states, strict=True)):
        health, values = link.health[place], state.values
        mode = values.get("operating_mode")
        table.add_row(
            servo.name,
            str(servo.id),
            servo.units.model.name,
            str(state.firmware),
            "" if mode is None else OperatingMode(mode).name.lower().replace("_", " "),
            {True: "on", False: "off", None: ""}[health.torque],
            f"{positions[place]:.4f}",
            str(frame.position[place]),
            health.error_text,
        )
    return table


# ------------------------------------------------------------------------------------------- calibrate


def calibrate(config: DynamixelConfig, options: CalibrateOptions) -> int:
    """Read the servos in a pose that is known, and keep by how much they are off."""
    path = options.out or config.calibration
    if not path:
        raise ConfigError(
            "there is no file for the calibration",
            where="calibrate",
            remedy="Give --out, or the key calibration in the configuration.",
        )
    chain = Chain.of(config, checks_ranges=False)
    positions = _pose(options.at, chain.names)
    with _opened(config, reads_only=True) as link:
        told = ", ".join(f"{name} {value:g}" for name, value in positions.items())
        if options.ask:
            _OUT.input(f"Put the joints by hand to: {told} (rad). Then press Enter ")
        frame = link.exchange()
        if not frame.valid.all():
            raise ConnectionFailed("a servo does not answer", where=link.address)
        found = calibration_of(
            [((s.name, s.bus, s.id, s.units.model.name), s.units) for s in chain.servos],
            frame.position.tolist(),
            [state.values.get("homing_offset", 0) for state in link.states],
            [positions[servo.name] for servo in chain.servos],
            in_eeprom=options.eeprom,
        )
    save_calibration(path, found)
    if config.turns:  # what was kept there counts from another middle
        TurnsFile(config.turns).save(Turns(clean=True, positions=dict(positions)))
    table = Table("joint", "id", "shift", "homing offset", box=None, pad_edge=False)
    for servo in found.servos:
        table.add_row(servo.joint, str(servo.id), str(servo.shift), str(servo.homing_offset))
    _OUT.print(table)
    _OUT.print(f"written: {path}", markup=False, soft_wrap=True)
    try:
        Chain.of(config, found)
    except ConfigError as error:
        why = f"The driver does not start with it yet: {error.message}. {error.remedy}"
        _OUT.print(why, markup=False, soft_wrap=True)
    return 0


def _pose(text: str, names: Sequence[str]) -> Mapping[str, float]:
    try:
        given = yaml.safe_load(text) if text else {}
        pose = {str(name): float(value) for name, value in dict(given).items()}
    except (yaml.YAMLError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{text!r} is no pose: {error}",
            where="--at",
            remedy="Write it as {elbow: 1.57, wrist: 0}.",
        ) from error
    strange = sorted(pose.keys() - set(names))
    if strange or not np.isfinite(list(pose.values())).all():
        raise ConfigError(
            f"{text!r}: no joint is called {', '.join(strange)}"
            if strange
            else f"{text!r}: not finite",
            where="--at",
            remedy=f"The joints are {', '.join(names)}.",
        )
    return {name: pose.get(name, 0.0) for name in names}


# --------------------------------------------------------------------------------------------- limits


def limits(config: DynamixelConfig, options: LimitsOptions) -> int:
    """Write the limits of the configuration into the servos where they differ; the torque must be off.

    Nothing is written before all servos were found fit for it.
    """
    with _opened(config, configured_calibration(config.calibration)) as link:
        wanted: dict[int, list[OwnLimit]] = {}
        for place, state in enumerate(link.states):
            known = own_limits(link.chain, link.chain.servos[place], state.table, state.values)
            if differing := [limit for limit in known if limit.differs]:
                wanted[place] = differing
        if not wanted:
            _OUT.print("The servos have the limits of the configuration.")
            return 0
        if options.write:
            _check_writable(link, wanted)
        for place, found in wanted.items():
            if options.write:
                _write_limits(link, place, found)
            for limit in found:
                done = "changed" if options.write else "differs"
                line = f"{done}: {limit.register} {limit.read} to {limit.wanted} ({limit.text})"
                _OUT.print(
                    f"{link.chain.servos[place].place}: {line}", markup=False, soft_wrap=True
                )
    return 0


def _check_writable(link: ChainLink, places: Iterable[int]) -> None:
    """Make sure that EEPROM may be written, and that counts mean what the calibration says.

    Raises:
        ConnectionFailed: a servo has torque, or waits for its homing offset.
    """
    for place in places:
        state, servo = link.states[place], link.chain.servos[place]
        if state.values.get("torque_enable"):
            raise ConnectionFailed(
                f"{servo.place} has torque, with which its EEPROM cannot be written",
                where=link.address,
                remedy="Support the arm, send disable, end the driver, and try again.",
            )
        calibrated = link.placement.calibrated.get((servo.bus, servo.id))
        offset = state.values.get("homing_offset")
        if calibrated is not None and offset not in (None, calibrated.homing_offset):
            raise ConnectionFailed(
                f"{servo.place} does not have its homing offset yet: {offset}, not "
                f"{calibrated.homing_offset}, and counts other positions",
                where=link.address,
                remedy="Enable it once, which writes the offset; then try again.",
            )


def _write_limits(link: ChainLink, place: int, found: Sequence[OwnLimit]) -> None:
    """Write limits, and read them back.

    Raises:
        ServoSilent, ServoCorrupt, ServoRefused: the servo does not answer, or says no.
        ConnectionFailed: it holds others.
    """
    link.write_checked(place, {limit.register: limit.wanted for limit in found})
    values = link.states[place].values
    refused = [limit.register for limit in found if values[limit.register] != limit.wanted]
    if refused:
        raise ConnectionFailed(
            f"{link.chain.servos[place].place} did not take {', '.join(refused)}",
            where=link.address,
            remedy="Look at these registers with DYNAMIXEL Wizard.",
        )


@contextmanager
def _opened(
    config: DynamixelConfig, calibration: Calibration | None = None, *, reads_only: bool = False
) -> Iterator[ChainLink]:
    """Open the link to a chain; with `reads_only` wherever its joints stand."""
    chain = Chain.of(config, calibration, checks_ranges=not reads_only)
    link = ChainLink(config, chain, calibration, finds_turns=not reads_only)
    link.open(time.monotonic() + config.open_timeout)
    try:
        yield link
    finally:
        link.close()
