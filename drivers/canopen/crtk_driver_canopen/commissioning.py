"""Makes the drives of a configuration ready to be started: checked, watched, mapped, parameters written.

Nothing here moves anything or applies power. Every value is read back; what a drive ignores is an error
that names node, object, wanted and found.
"""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Final

from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.drive_profile import (
    PLAIN,
    DriveProfile,
    built_in,
    kin,
    named,
    of_identity,
)
from crtk_driver_canopen.heartbeat import NodeLife, ensure_abort_option, ensure_heartbeat
from crtk_driver_canopen.identity import Identity, check_identity, read_identity
from crtk_driver_canopen.joint_config import MODE_NAMES, HomingConfig, JointConfig
from crtk_driver_canopen.lacking import (
    check_changes,
    ensure_mode,
    ensure_period,
    missing_objects,
    note_missing,
)
from crtk_driver_canopen.layout import FEEDBACK, CobIds, Layout, plan
from crtk_driver_canopen.lowered_limits import LoweredLimits
from crtk_driver_canopen.master import Master
from crtk_driver_canopen.modes import MODES, OpMode, Way, mode_text, supported
from crtk_driver_canopen.objects import OBJECTS, Entry, ObjectType
from crtk_driver_canopen.parameters import write_parameters
from crtk_driver_canopen.pdo import (
    MOST_PDOS,
    Direction,
    NotMapped,
    configure,
    disable,
    read_cob_id,
    set_deadline,
)
from crtk_driver_canopen.plausibility import check_plausible
from crtk_driver_canopen.profiles import ProfileRates
from crtk_driver_canopen.read_once import Readings
from crtk_driver_canopen.safeguards import (
    PositionLimits,
    ensure_error_behaviour,
    ensure_options,
    note_following_error,
    position_limits,
    write_position_limits,
    write_speed_limits,
)
from crtk_driver_canopen.sdo import Sdo
from crtk_driver_canopen.standard import ROWS, Row
from crtk_driver_canopen.statemachine import STAYS_IN_QUICK_STOP
from crtk_driver_canopen.unit_table import UNITS, Quantity, keys_text
from crtk_driver_canopen.units import (
    JointUnits,
    UnitObjects,
    check_wire,
    home_counts,
    read_unit_objects,
    resolve,
)
from crtk_drivers.errors import ConfigError, ConnectionFailed, DeviceError

logger = logging.getLogger(__name__)

_RAMPS: Final = ("profile_acceleration", "profile_deceleration")
_CYCLIC: Final = frozenset({OpMode.CSP, OpMode.CSV, OpMode.CST, OpMode.IP})

_USUAL_PDOS = 4
"""PDOs of each direction that most drives have; those from there on are looked for until one is missing."""


@dataclass(frozen=True)
class Prepared:
    """What is known of a joint once its drive is ready.

    Attributes:
        identity: of its node.
        drive: what the drive tells of its units.
        units: of the joint.
        modes: that the drive has.
        position: (6064) in counts, before it was started.
        limits: of position that the drive holds (607D); None: none of ours.
        stays_in_quick_stop: for `crtk_driver_canopen.statemachine.Drive402`.
        notes: what is not as it should be, in words.
    """

    identity: Identity
    drive: UnitObjects
    units: JointUnits
    modes: frozenset[OpMode]
    position: int
    limits: PositionLimits | None
    stays_in_quick_stop: bool
    notes: tuple[str, ...]


def prepare(
    master: Master,
    config: CanopenConfig,
    layout: Layout,
    nodes: Iterable[int] | None = None,
    lowered: LoweredLimits | None = None,
    readings: Readings | None = None,
) -> dict[str, Prepared]:
    """Make drives ready; they must be pre-operational.

    Args:
        master: of the open bus.
        nodes: only these; all of the configuration if None.
        lowered: takes note of the limits of speed that the drives held before, if not None.
        readings: what has been read of them just before; nothing if None.

    Returns:
        What is known of each of their joints, by name.

    Raises:
        WrongDevice: another device than the configured one has a node id.
        PdoMismatch, ObjectIgnored: a drive acknowledged something and does not hold it.
        DeviceError: a drive lacks a mode or an object that is needed.
        NotMapped: a drive does not let an object be in a PDO; without it in the layout, it may do.
        ConfigError: a file cannot be read, nobody tells the units of a joint, or they are not plausible.
        SdoAborted, SdoSilent, ProtocolError, BusLost: a drive did not answer as it should.
    """
    prepared: dict[str, Prepared] = {}
    readings = readings or Readings(master)
    lowered = lowered or LoweredLimits()
    for node in config.nodes if nodes is None else nodes:
        joints = {name: joint for name, joint in config.joints.items() if joint.node == node}
        prepared |= _node(master, readings, lowered, config, layout, node, joints)
    return {name: prepared[name] for name in config.joints if name in prepared}


def prepare_all(
    master: Master,
    config: CanopenConfig,
    layout: Layout,
    told: CobIds | None,
    lowered: LoweredLimits,
    readings: Readings,
    deadline: float,
) -> tuple[dict[str, Prepared], Layout]:
    """Make all drives ready, without the feedback that one of them lacks or cannot have in a PDO.

    Args:
        master: of the open bus.
        layout: PDOs with all feedback.
        told: COB-IDs that the drives have, where they count.
        lowered: takes note of the limits of speed that the drives held before.
        readings: what has been read of them just before.
        deadline: monotonic seconds.

    Returns:
        What is known of each joint, and the PDOs that the drives have.

    Raises:
        ConnectionFailed: the time was over.
        DeviceError, ConfigError, SdoSilent, ProtocolError, BusLost: as `prepare`.
    """
    facts: dict[str, Prepared] = {}
    lacks: set[tuple[int, Entry]] = set()
    nodes = deque(config.nodes)
    while nodes:
        node = nodes[0]
        if time.monotonic() > deadline:
            raise ConnectionFailed(
                f"the time was over before node {node} was set up",
                where=master.link.where,
                remedy="Raise open_timeout.",
            )
        try:
            facts |= prepare(master, config, layout, [node], lowered, readings)
        except NotMapped as error:
            lacks.add((node, error.entry))
            less = plan(config, told, lacks)
            if less.tpdos.sizes == layout.tpdos.sizes:
                raise  # it is no feedback, and nothing stands in for it
            layout = less
        else:
            nodes.popleft()
    return {name: facts[name] for name in config.joints}, layout


def _node(
    master: Master,
    readings: Readings,
    lowered: LoweredLimits,
    config: CanopenConfig,
    layout: Layout,
    node: int,
    joints: dict[str, JointConfig],
) -> dict[str, Prepared]:
    sdo = readings.sdo(node)
    identity = read_identity(sdo)
    check_identity(identity, next(iter(joints.values())).identity.wanted, sdo.where)
    notes: list[str] = []
    beats = config.heartbeat

    life = master.watch.nodes.setdefault(node, NodeLife(0.0))
    life.mute = not sdo.has(OBJECTS["producer_heartbeat_time"])

    def watch() -> None:
        ensure_heartbeat(
            sdo,
            produced_ms=round(1000 * beats.drives),
            watched=config.master_node,
            watched_ms=round(1000 * beats.ours_timeout),
        )

    _watched(config, watch, notes)
    behaviour = beats.error_behaviour
    if behaviour is not None:
        _watched(config, lambda: ensure_error_behaviour(sdo, behaviour), notes)
    found = sdo.find(OBJECTS["synchronous_counter_overflow"])
    if config.sync_counter or found:
        sdo.ensure(OBJECTS["synchronous_counter_overflow"], config.sync_counter)
    made = {}
    for name, joint in joints.items():
        profile = named(joint.profile) or _by_identity(identity, notes)
        master.profiles[node] = profile
        axis = readings.sdo(node, joint.axis)
        note_missing(axis, _unmeasured(config, layout, joint), notes)
        made[name] = _axis(axis, config, name, joint, identity, profile, lowered, notes)
    _map(sdo, layout, node)

    def set_deadlines() -> None:
        for pdo in layout.rpdos.pdos:
            if pdo.node == node:
                set_deadline(sdo, pdo, round(1000 * beats.ours_timeout))

    _watched(config, set_deadlines, notes)
    for name, joint in joints.items():
        # Only one mode, and no PDO that carries it: it is set here, once.
        if len(joint.modes) == 1 and joint.homing is None:
            axis, told = readings.sdo(node, joint.axis), list(made[name].notes)
            ensure_mode(axis, name, joint.op_modes[0], told)
            made[name] = replace(made[name], notes=tuple(told))
    return made


def _unmeasured(config: CanopenConfig, layout: Layout, joint: JointConfig) -> list[Row]:
    """Return what a joint is to measure and does not: its drive has it not, or not in a PDO."""
    mapped = {entry for pdo in layout.tpdos.pdos if pdo.node == joint.node for entry in pdo.entries}
    wanted = {FEEDBACK[name] for name in config.feedback}
    return [
        row for row in ROWS if row.name in wanted and row.entry.on_axis(joint.axis) not in mapped
    ]


def _watched(config: CanopenConfig, ensure: Callable[[], None], notes: list[str]) -> None:
    """Do what makes a drive stop by itself; refuse a drive that does not, unless that is allowed."""
    try:
        ensure()
    except DeviceError as error:
        if config.heartbeat.required:
            raise
        logger.warning("%s", error)
        notes.append(str(error))


def _axis(
    sdo: Sdo,
    config: CanopenConfig,
    name: str,
    joint: JointConfig,
    identity: Identity,
    profile: DriveProfile,
    lowered: LoweredLimits,
    notes: list[str],
) -> Prepared:
    modes = _modes(sdo, name, joint, profile)
    used = set(joint.op_modes) | ({OpMode.HM} if joint.homing is not None else set())
    lacks = missing_objects(sdo, name, used, _homing_rates(joint.homing))
    note_missing(sdo, lacks, notes)
    if len(used) > 1:
        check_changes(sdo, name)
    write_parameters(sdo, name, joint, notes)
    halts = config.drives_plan or joint.homing is not None
    _watched(config, lambda: ensure_options(sdo, name, joint, notes, halts=halts), notes)
    if joint.abort_option is not None:
        option = joint.abort_option
        _watched(config, lambda: ensure_abort_option(sdo, option), notes)
    if _CYCLIC & set(joint.op_modes) and sdo.has(OBJECTS["interpolation_period_value"]):
        ensure_period(sdo, config.period)
    drive = read_unit_objects(sdo, profile)
    units = resolve(name, joint, drive)
    check_wire(name, joint, units)
    _note_assumed(config, joint, units, notes)
    notes += check_plausible(sdo, name, joint, units, drive, moves=config.drives_plan)
    _profile(sdo, name, joint, units, moves=config.drives_plan)
    if joint.homing is not None:
        _homing(sdo, name, joint.homing, units, profile)
    if Way.EFFORTS in joint.ways and math.isnan(units.effort):
        raise _effort_needed(name, joint, drive)
    position = sdo.read(OBJECTS["position_actual"])
    limits: PositionLimits | None = None
    write_speed_limits(sdo, joint, units, drive, lowered, notes)
    if joint.homing is None or not joint.homing.required:
        # Before homing nobody knows where the range is.
        limits = position_limits(joint, units).widened(position)
        limits = limits if write_position_limits(sdo, joint, limits, notes) else None
    if Way.POSITIONS in joint.ways:
        note_following_error(sdo, notes)
    step = abs(units.velocity if units.measured_velocity is None else units.measured_velocity)
    if step > _COARSE * joint.velocity:
        notes.append(
            f"velocities count in steps of {step:.3g} (60A9h): slower ones are 0, and a joint "
            "at one step or less counts as standing; a finer unit in the drive tells more"
        )
    stays = sdo.find(OBJECTS["quick_stop_option"]) in STAYS_IN_QUICK_STOP
    return Prepared(identity, drive, units, modes, position, limits, stays, tuple(notes))


def _effort_needed(name: str, joint: JointConfig, drive: UnitObjects) -> ConfigError:
    text = "the drive does not tell the rated torque of its motor (6076h), of which efforts are thousandths"
    key = "rated_torque"
    if joint.rated_torque or drive.rated_torque:
        text, key = "nobody tells the way of a turn, from which forces follow", "feed"
    return ConfigError(
        text,
        where=f"joints.{name}",
        remedy=f"Give `{key}`, or `effort_scale`, or `effort: 0`.",
    )


_COARSE: Final = 0.02
"""Share of its limit from which the step of a joint's velocity is told."""


def _by_identity(identity: Identity, notes: list[str]) -> DriveProfile:
    """Return the profile of a drive by who it is; where it may have one all the same, that is noted."""
    profile = of_identity(identity)
    other = kin(identity) if profile is PLAIN else ""
    if other:
        notes.append(
            f"another product ({identity}) of the maker of {other}: it is used as CiA 402 says; give "
            f"`profile: {other}` if it is one of these"
        )
        # Its rated torque may count otherwise, as that of the others does: the motor's own data tell.
        return profile.model_copy(update={"motor": built_in()[other].motor})
    return profile


def _modes(sdo: Sdo, name: str, joint: JointConfig, profile: DriveProfile) -> frozenset[OpMode]:
    word = sdo.find(OBJECTS["supported_drive_modes"])
    if word is None:
        return frozenset(MODES)  # it does not tell: the first change of mode will
    modes = supported(word) | profile.more_modes
    wanted = set(joint.op_modes) | ({OpMode.HM} if joint.homing is not None else set())
    missing = sorted(wanted - modes)
    if missing:
        has = ", ".join(map(mode_text, sorted(modes))) or f"no mode at all (6502h is 0x{word:x})"
        raise DeviceError(
            f"joint {name}: the drive does not have {', '.join(map(mode_text, missing))}, but {has}",
            where=sdo.where,
            remedy=_mode_remedy(name, modes),
        )
    return modes


def _mode_remedy(name: str, modes: frozenset[OpMode]) -> str:
    usable = [text for text, mode in MODE_NAMES.items() if mode in modes]
    given = f"Give `joints.{name}.modes` of {', '.join(usable)}" if usable else "Use another drive"
    homing = "" if OpMode.HM in modes else ", and no `homing`"
    return (
        f"{given}{homing}; or, if it has the mode although 6502h does not name it, a `profile` that "
        "says so."
    )


def _uses(config: CanopenConfig, joint: JointConfig) -> set[Quantity]:
    """Return the rates that a drive is given, or that are taken from it."""
    ramps = config.drives_plan or OpMode.PV in joint.op_modes
    homing = joint.homing
    used = {Quantity.ACCELERATION} if ramps or (homing and homing.acceleration) else set()
    if ramps or Way.VELOCITIES in joint.ways or "velocity" in config.feedback:
        used.add(Quantity.VELOCITY)
    if Way.EFFORTS in joint.ways:
        used.add(Quantity.EFFORT)
    return used


def _note_assumed(
    config: CanopenConfig, joint: JointConfig, units: JointUnits, notes: list[str]
) -> None:
    """Note each unit that is used and that nobody tells."""
    used = _uses(config, joint)
    if math.isnan(units.acceleration_step):
        used.discard(Quantity.ACCELERATION)  # that is refused
    notes += [
        f"{units.assumed[quantity]}; look into its manual, and give {keys_text(quantity)}"
        for quantity in sorted(units.assumed.keys() & used)
    ]


def _acceleration_needed(name: str, units: JointUnits) -> ConfigError:
    source = UNITS[Quantity.ACCELERATION]
    return ConfigError(
        units.assumed.get(Quantity.ACCELERATION)
        or f"velocities have a unit of their own (`velocity_scale`), and nobody tells that of accelerations "
        f"({source.objects}): the drive has no {source.reported}",
        where=f"joints.{name}",
        remedy=f"Give {keys_text(Quantity.ACCELERATION)}, by the drive's manual.",
    )


def _profile(sdo: Sdo, name: str, joint: JointConfig, units: JointUnits, *, moves: bool) -> None:
    """Give a drive that makes its own ramps the limits of the joint."""
    if not moves and OpMode.PV not in joint.op_modes:
        return
    ramps = [entry for entry in _RAMPS if sdo.has(OBJECTS[entry])]
    if ramps and units.ramp_time is None and math.isnan(units.acceleration_step):
        raise _acceleration_needed(name, units)
    rates = ProfileRates.in_units(joint.velocity, joint.acceleration, units)
    remedy = "Check the limits of the joint against the drive's."
    if sdo.has(OBJECTS["profile_velocity"]):
        sdo.ensure(OBJECTS["profile_velocity"], rates.velocity, remedy)
    for entry in ramps:
        sdo.ensure(OBJECTS[entry], rates.acceleration, remedy)


def _homing_rates(homing: HomingConfig | None) -> dict[str, float]:
    """Return the rates that are configured, by object."""
    if homing is None:
        return {}
    rates = {
        "homing_speed_switch": homing.speed_switch,
        "homing_speed_zero": homing.speed_zero,
        "homing_acceleration": homing.acceleration,
    }
    return {name: rate for name, rate in rates.items() if rate is not None}


def _homing(
    sdo: Sdo, name: str, homing: HomingConfig, units: JointUnits, profile: DriveProfile
) -> None:
    sdo.ensure(OBJECTS["homing_method"], homing.method)
    for entry, rate in _homing_rates(homing).items():
        if not sdo.has(OBJECTS[entry]):
            continue
        is_ramp = entry == "homing_acceleration"
        speed = max(1, round(rate / abs(units.velocity)))  # with 0 it would never be there
        counts = _homing_ramp(name, homing, units) if is_ramp else speed
        sdo.ensure(OBJECTS[entry], counts)
    if homing.position is not None:
        home = profile.home_entry
        if sdo.find(home) is None:
            raise DeviceError(
                f"joint {name}: the drive has no {home}, which takes the position at the home point",
                where=sdo.where,
                remedy=f"Leave `joints.{name}.homing.position` out, and give `offset` for where the drive "
                "counts 0; or give a `profile` with its `home_position`.",
            )
        counts = home_counts(homing.position, units)
        sdo.ensure(home, -counts if homing.home_offset == "zero" else counts)


def _homing_ramp(name: str, homing: HomingConfig, units: JointUnits) -> int:
    """Return what 609Ah is to be, in the units of its drive.

    Raises:
        ConfigError: nobody tells its unit, or it is a time and no speed is configured.
    """
    assert homing.acceleration is not None
    if units.ramp_time is None:
        if math.isnan(units.acceleration_step):
            raise _acceleration_needed(name, units)
        return max(1, round(homing.acceleration / units.acceleration_step))
    if homing.speed_switch is None:
        raise ConfigError(
            "the drive takes the time of a ramp (609Ah), which follows from speed and acceleration",
            where=f"joints.{name}.homing",
            remedy="Give `homing.speed_switch` too.",
        )
    return max(1, round(homing.speed_switch / homing.acceleration / units.ramp_time))


def _map(sdo: Sdo, layout: Layout, node: int) -> None:
    """Write the PDOs of a node, and switch off those that it has besides."""
    for direction, group in (
        (Direction.RECEIVE, layout.rpdos),
        (Direction.TRANSMIT, layout.tpdos),
    ):
        mine = [pdo for pdo in group.pdos if pdo.node == node]
        used = {pdo.number for pdo in mine}
        for number in range(1, MOST_PDOS + 1):
            # Whatever is valid from the factory would go on, or take what is meant for another.
            if number in used:
                continue
            if not disable(sdo, node, direction, number) and number > _USUAL_PDOS:
                break
        for pdo in mine:
            if configure(sdo, pdo):
                logger.debug("%s: %s written", sdo.where, pdo)
    cob_id = Entry(0x1005, 0, ObjectType.U32, "COB-ID of SYNC")
    found = sdo.find(cob_id)
    if found is not None and found & 0x400007FF != 0x80:
        sdo.ensure(
            cob_id, 0x80, "The node would produce SYNC itself, or take another COB-ID for it."
        )


def read_cob_ids(readings: Readings, layout: Layout) -> CobIds:
    """Return the COB-IDs that the drives have for the PDOs that a layout asks for.

    Raises:
        DeviceError: a drive has none, or does not tell.
    """
    return {
        (node, direction, number): read_cob_id(readings.sdo(node), direction, number)
        for node, direction, number in layout.asked
    }
