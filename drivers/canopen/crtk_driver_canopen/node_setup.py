"""What is written into the drives before they are used, all of it by SDO and read back.

Everything that a drive keeps only until its next start is written when the bus is opened, and again in
`enable` for a drive that has started anew since. Nothing here moves a motor or gives it power.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from crtk_driver_canopen.config import CanopenConfig, HomingConfig, JointConfig
from crtk_driver_canopen.heartbeat import ensure_abort_option, ensure_heartbeat
from crtk_driver_canopen.identity import Identity, check_identity, read_identity
from crtk_driver_canopen.layout import Layout
from crtk_driver_canopen.modes import MODES, OpMode, supported
from crtk_driver_canopen.objects import OBJECTS, Entry, ObjectType, object_text, parse_object
from crtk_driver_canopen.pdo import Direction, configure, disable
from crtk_driver_canopen.sdo import ObjectIgnored, Sdo, SdoAborted, SdoPort
from crtk_driver_canopen.statemachine import STAYS_IN_QUICK_STOP
from crtk_driver_canopen.units import (
    JointUnits,
    interpolation_period,
    read_unit_objects,
    resolve,
)
from crtk_drivers.errors import ConfigError, DeviceError

__all__ = ["AxisFacts", "NodeSetup"]

PREDEFINED_PDOS: Final = range(1, 5)
"""PDOs that a node may have mapped by itself: those that are not ours are switched off."""


@dataclass(frozen=True, slots=True)
class AxisFacts:
    """What was found out about an axis.

    Attributes:
        units: of its joint.
        stays_in_quick_stop: after a quick stop it can go on.
    """

    units: JointUnits
    stays_in_quick_stop: bool


class NodeSetup:
    """Sets up one node.

    Args:
        config: of the arm.
        layout: its PDOs.
        node: id.
    """

    def __init__(self, config: CanopenConfig, layout: Layout, node: int) -> None:
        self._config = config
        self._layout = layout
        self.node = node
        self.joints = {n: joint for n, joint in config.joints.items() if joint.node == node}

    def run(self, port: SdoPort) -> dict[str, AxisFacts]:
        """Check who the node is, write all of it, and return what was found out, by joint.

        The node is pre-operational.

        Raises:
            DeviceError, DataTimeout: it is another device, lacks what is needed, or does not answer.
            ConfigError: units that cannot be told.
        """
        sdo = Sdo(port)
        first = next(iter(self.joints.values()))
        check_identity(read_identity(sdo), first.identity.wanted, sdo.where)
        self._write_heartbeat(sdo)
        if self._config.sync_counter:
            sdo.ensure(OBJECTS["synchronous_counter_overflow"], self._config.sync_counter)
        facts = {name: self._axis(name, joint, port) for name, joint in self.joints.items()}
        self._write_pdos(sdo)
        return facts

    def identity(self, port: SdoPort) -> Identity:
        """Return who the node is.

        Raises:
            DeviceError, DataTimeout: it does not answer.
        """
        return read_identity(Sdo(port))

    def _write_heartbeat(self, sdo: Sdo) -> None:
        heartbeat = self._config.heartbeat
        try:
            ensure_heartbeat(
                sdo,
                produced_ms=round(heartbeat.drives * 1000),
                watched=self._config.master_node,
                watched_ms=round(heartbeat.ours_timeout * 1000),
            )
        except (ObjectIgnored, SdoAborted):
            if heartbeat.required:
                raise

    def _axis(self, name: str, joint: JointConfig, port: SdoPort) -> AxisFacts:
        sdo = Sdo(port, joint.axis)
        self._check_modes(name, joint, sdo)
        for text, value in joint.parameters.items():
            _write_parameter(sdo, text, value)
        if joint.quick_stop_option is not None:
            sdo.ensure(OBJECTS["quick_stop_option"], joint.quick_stop_option)
        self._write_abort_option(joint, sdo)
        self._write_period(joint, sdo)
        units = resolve(name, joint, read_unit_objects(sdo))
        for entry, value in _homing_objects(joint.homing, units):
            sdo.ensure(entry, value)
        if len(joint.modes) == 1 and joint.homing is None:
            sdo.ensure(OBJECTS["mode_of_operation"], int(joint.op_modes[0]))
        option = sdo.find(OBJECTS["quick_stop_option"])
        return AxisFacts(units, option in STAYS_IN_QUICK_STOP)

    def _check_modes(self, name: str, joint: JointConfig, sdo: Sdo) -> None:
        word = sdo.find(OBJECTS["supported_drive_modes"])
        if word is None:
            return
        can = supported(word)
        wanted = [*joint.op_modes, *([OpMode.HM] if joint.homing is not None else [])]
        missing = [MODES[mode].name for mode in wanted if mode not in can]
        if missing:
            raise DeviceError(
                f"joint {name}: the drive has no {', '.join(missing)} (6502h)",
                where=sdo.where,
                remedy=f"It has: {', '.join(MODES[mode].name for mode in sorted(can))}. Correct `modes`.",
            )

    def _write_abort_option(self, joint: JointConfig, sdo: Sdo) -> None:
        if joint.abort_option is None:
            return
        try:
            ensure_abort_option(sdo, joint.abort_option)
        except DeviceError:
            if self._config.heartbeat.required:
                raise

    def _write_period(self, joint: JointConfig, sdo: Sdo) -> None:
        """Tell the drive the time between two setpoints; one with no such object goes by the SYNC."""
        cyclic = {OpMode.CSP, OpMode.CSV, OpMode.CST, OpMode.IP}
        if not cyclic.intersection(joint.op_modes):
            return
        value, exponent = interpolation_period(self._config.period)
        names = ("interpolation_period_value", "interpolation_period_exponent")
        for name, number in zip(names, (value, exponent), strict=True):
            if sdo.find(OBJECTS[name]) is not None:
                sdo.ensure(OBJECTS[name], number)

    def _write_pdos(self, sdo: Sdo) -> None:
        groups = (
            (Direction.RECEIVE, self._layout.rpdos.pdos),
            (Direction.TRANSMIT, self._layout.tpdos.pdos),
        )
        for direction, pdos in groups:
            ours = [pdo for pdo in pdos if pdo.node == self.node]
            for number in PREDEFINED_PDOS:
                if number not in {pdo.number for pdo in ours}:
                    disable(sdo, self.node, direction, number)
            for pdo in ours:
                configure(sdo, pdo)


def _homing_objects(homing: HomingConfig | None, units: JointUnits) -> Iterator[tuple[Entry, int]]:
    """Yield the objects of homing and their values, those that the configuration gives."""
    if homing is None:
        return
    speed = abs(units.velocity)
    given: Mapping[str, float | None] = {
        "homing_method": float(homing.method),
        "homing_speed_switch": _per(homing.speed_switch, speed),
        "homing_speed_zero": _per(homing.speed_zero, speed),
        "homing_acceleration": _per(homing.acceleration, speed),
        # The drive counts this at the home position: 607Ch is where zero is, seen from there.
        "home_offset": _per(_from(homing.position, units.offset), units.position),
    }
    for name, value in given.items():
        if value is not None:
            yield OBJECTS[name], round(value)


def _per(value: float | None, unit: float) -> float | None:
    return None if value is None else value / unit


def _from(value: float | None, offset: float) -> float | None:
    return None if value is None else value - offset


def _write_parameter(sdo: Sdo, text: str, value: int) -> None:
    index, sub = parse_object(text)
    known = {(entry.index, entry.sub): entry for entry in OBJECTS.values()}
    entry = known.get((index, sub))
    if entry is None:
        size = len(sdo.port.upload(index, sub))
        kinds = {1: ObjectType.U8, 2: ObjectType.U16, 4: ObjectType.U32, 8: ObjectType.U64}
        if size not in kinds:
            raise ConfigError(
                f"{object_text(index, sub)} has {size} bytes, which is no whole number",
                where=f"{sdo.where} parameters",
                remedy="Only objects that are whole numbers can be given here.",
            )
        bits = 8 * size
        value &= (1 << bits) - 1
        entry = Entry(index, sub, kinds[size], "parameter")
    sdo.ensure(entry, value)
