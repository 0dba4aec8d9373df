"""Which PDOs the joints of a configuration need, and whether their cycle fits the bus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from crtk_driver_canopen.busload import BusLoad, check_load, cycle_load
from crtk_driver_canopen.config import CanopenConfig, JointConfig
from crtk_driver_canopen.modes import TARGETS
from crtk_driver_canopen.objects import OBJECTS, Entry
from crtk_driver_canopen.pdo import Direction, Pdo, PdoGroup
from crtk_drivers.errors import ConfigError

__all__ = ["Layout", "plan"]

_SDO_RATE = 20.0
"""SDO requests per second that are reckoned with while the arm moves."""

_PDOS_OF_A_NODE = 4
"""That have a COB-ID in the predefined connection set."""

_FEEDBACK = {"velocity": "velocity_actual", "effort": "torque_actual"}


@dataclass(frozen=True)
class Layout:
    """PDOs of an arm.

    Attributes:
        tpdos: what the drives send.
        rpdos: what they are sent.
        load: that their cycle is for the bus.
    """

    tpdos: PdoGroup
    rpdos: PdoGroup
    load: BusLoad


def plan(config: CanopenConfig) -> Layout:
    """Return the PDOs of a configuration.

    The first PDO of each axis has controlword and first target, or statusword and position; with
    homing or more than one mode also the mode. What does not fit follows in a second one.

    Raises:
        ConfigError: a node needs more PDOs than it has, or the cycle does not fit the bus.
    """
    orders: Counter[tuple[int, Direction]] = Counter()
    rpdos: list[Pdo] = []
    tpdos: list[Pdo] = []
    for name, joint in config.joints.items():
        out, slow = _receive(joint), _feedback(config)
        changes = len(joint.modes) > 1 or joint.homing is not None
        first = ["statusword", "position_actual"]
        if changes:
            first.append("mode_of_operation_display")
        rpdos += _pdos(name, joint, Direction.RECEIVE, [out], orders)
        every = config.feedback_every
        parts = [[*first, *slow]] if every == 1 else [first, slow]
        made = _pdos(name, joint, Direction.TRANSMIT, parts, orders)
        tpdos += [made[0], *(replace(pdo, transmission=every) for pdo in made[1:])]
    heartbeat = config.heartbeat
    beats = [heartbeat.drives] * len(config.nodes) if heartbeat.drives else []
    load = cycle_load(
        [*rpdos, *tpdos],
        period=config.period,
        bitrate=config.bus.bitrate,
        sync_bytes=1 if config.sync_counter else 0,
        heartbeats=[*beats, heartbeat.ours] if heartbeat.ours else beats,
        sdo_rate=_SDO_RATE,
    )
    check_load(load, config.bus.load_limit, f"canopen {config.bus.interface} {config.bus.channel}")
    return Layout(PdoGroup(tpdos), PdoGroup(rpdos), load)


def _receive(joint: JointConfig) -> list[str]:
    targets = list(dict.fromkeys(TARGETS[mode] for mode in joint.op_modes))
    changes = len(joint.modes) > 1 or joint.homing is not None
    return ["controlword", targets[0], *(["mode_of_operation"] if changes else []), *targets[1:]]


def _feedback(config: CanopenConfig) -> list[str]:
    return [_FEEDBACK[name] for name in dict.fromkeys(config.feedback)]


def _pdos(
    name: str,
    joint: JointConfig,
    direction: Direction,
    parts: Iterable[list[str]],
    orders: Counter[tuple[int, Direction]],
) -> list[Pdo]:
    """Return PDOs that carry the objects in order; each part begins one of its own."""
    number = joint.first_rpdo if direction is Direction.RECEIVE else joint.first_tpdo
    made: list[Pdo] = []
    for entries in _filled(joint, parts):
        orders[joint.node, direction] += 1
        order = orders[joint.node, direction]
        if order > _PDOS_OF_A_NODE:
            raise ConfigError(
                f"node {joint.node} would need more than {_PDOS_OF_A_NODE} {direction}s",
                where=f"joints.{name}",
                remedy="Use fewer modes, or less feedback.",
            )
        pdo = Pdo(joint.node, direction, order, entries)
        if number is not None:
            pdo = replace(pdo, number=number + len(made), cob_id=pdo.id)
        made.append(pdo)
    return made


def _filled(joint: JointConfig, parts: Iterable[list[str]]) -> Iterator[tuple[Entry, ...]]:
    """Yield what fits into 8 bytes each."""
    for part in parts:
        entries: list[Entry] = []
        for each in part:
            entry = OBJECTS[each].on_axis(joint.axis)
            if sum(other.type.bits for other in entries) + entry.type.bits > 64:
                yield tuple(entries)
                entries = []
            entries.append(entry)
        if entries:
            yield tuple(entries)
