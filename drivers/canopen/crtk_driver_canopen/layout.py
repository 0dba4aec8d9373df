"""Which PDOs the joints of a configuration need, and whether their cycle fits the bus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

from crtk_driver_canopen.busload import BusLoad, check_load, cycle_load
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.joint_config import JointConfig
from crtk_driver_canopen.modes import TARGETS
from crtk_driver_canopen.objects import OBJECTS, Entry
from crtk_driver_canopen.pdo import Direction, Pdo, PdoGroup, check_cob_ids, default_cob_id
from crtk_drivers.errors import ConfigError

_SDO_RATE = 20.0
"""SDO requests per second that are reckoned with while the arm moves."""

_PREDEFINED = 4
"""PDOs of a node and direction that have a COB-ID in the predefined connection set."""

CobIds = Mapping[tuple[int, Direction, int], int]
"""COB-IDs that drives have, by node, direction and number."""

FEEDBACK: Final = MappingProxyType({"velocity": "velocity_actual", "effort": "torque_actual"})
"""The object for each kind of feedback."""

Lacks = Collection[tuple[int, Entry]]
"""Nodes with objects (of their axis) that cannot be in their PDOs."""


@dataclass(frozen=True)
class Layout:
    """PDOs of an arm.

    Attributes:
        tpdos: what the drives send.
        rpdos: what they are sent.
        load: that their cycle is for the bus.
        asked: PDOs whose COB-IDs are those that the drives have: node, direction, number.
    """

    tpdos: PdoGroup
    rpdos: PdoGroup
    load: BusLoad
    asked: tuple[tuple[int, Direction, int], ...] = ()


def plan(config: CanopenConfig, told: CobIds | None = None, lacks: Lacks = ()) -> Layout:
    """Return the PDOs of a configuration.

    Args:
        config: of the arm.
        told: COB-IDs that the drives have, where they count. None: not known yet, and the layout is one
            for its sizes alone.
        lacks: feedback that is done without.

    The first PDO of each axis has controlword and first target, or statusword and position; with
    homing or more than one mode also the mode. What does not fit follows in a second one.

    Raises:
        ConfigError: a node needs more PDOs than have COB-IDs, a COB-ID is not free, or the cycle does not
            fit the bus.
    """
    makers = {
        direction: _Maker(direction, told) for direction in (Direction.RECEIVE, Direction.TRANSMIT)
    }
    rpdos: list[Pdo] = []
    tpdos: list[Pdo] = []
    for name, joint in config.joints.items():
        out, slow = _receive(joint), _feedback(config, joint, lacks)
        changes = len(joint.modes) > 1 or joint.homing is not None
        first = ["statusword", "position_actual"]
        if changes:
            first.append("mode_of_operation_display")
        rpdos += makers[Direction.RECEIVE].make(name, joint, [out])
        every = config.feedback_every
        parts = [[*first, *slow]] if every == 1 or not slow else [first, slow]
        made = makers[Direction.TRANSMIT].make(name, joint, parts)
        tpdos += [made[0], *(replace(pdo, transmission=every) for pdo in made[1:])]
    asked = tuple(which for maker in makers.values() for which in maker.asked)
    if told is not None or not asked:
        check_cob_ids([*tpdos, *rpdos])
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
    return Layout(PdoGroup(tpdos), PdoGroup(rpdos), load, asked)


def _receive(joint: JointConfig) -> list[str]:
    targets = list(dict.fromkeys(TARGETS[mode] for mode in joint.op_modes))
    changes = len(joint.modes) > 1 or joint.homing is not None
    return ["controlword", targets[0], *(["mode_of_operation"] if changes else []), *targets[1:]]


def _feedback(config: CanopenConfig, joint: JointConfig, lacks: Lacks) -> list[str]:
    names = [FEEDBACK[name] for name in dict.fromkeys(config.feedback)]
    return [n for n in names if (joint.node, OBJECTS[n].on_axis(joint.axis)) not in lacks]


class _Maker:
    """Makes the PDOs of one direction, joint by joint."""

    def __init__(self, direction: Direction, told: CobIds | None) -> None:
        self._direction = direction
        self._told = told
        self._orders: Counter[int] = Counter()
        self.asked: list[tuple[int, Direction, int]] = []

    def make(self, name: str, joint: JointConfig, parts: Iterable[list[str]]) -> list[Pdo]:
        """Return PDOs that carry the objects in order; each part begins one of its own."""
        receives = self._direction is Direction.RECEIVE
        first = joint.first_rpdo if receives else joint.first_tpdo
        asked = joint.rpdo_cob_ids if receives else joint.tpdo_cob_ids
        made: list[Pdo] = []
        for place, entries in enumerate(_filled(joint, parts)):
            self._orders[joint.node] += 1
            order = self._orders[joint.node]
            number = order if first is None else first + place
            cob_id = self._cob_id(f"joints.{name}", joint.node, asked, (place, order, number))
            made.append(Pdo(joint.node, self._direction, number, entries, cob_id=cob_id))
        return made

    def _cob_id(self, where: str, node: int, asked: object, which: tuple[int, int, int]) -> int:
        place, order, number = which
        direction = self._direction
        if isinstance(asked, tuple):
            if place >= len(asked):
                raise ConfigError(
                    f"needs {direction} {place + 1} of its own, but has {len(asked)} COB-IDs",
                    where=where,
                    remedy="Give more, or use fewer modes or less feedback.",
                )
            return int(asked[place])
        if asked == "drive":
            self.asked.append((node, direction, number))
            if self._told is None:
                return len(self.asked)  # only to tell them apart
            return self._told[node, direction, number]
        if order > _PREDEFINED:
            name = "rpdo_cob_ids" if direction is Direction.RECEIVE else "tpdo_cob_ids"
            raise ConfigError(
                f"node {node} would need more than {_PREDEFINED} {direction}s, and the others have no "
                "predefined COB-ID",
                where=where,
                remedy=f"Give `{name}`, or use fewer modes or less feedback.",
            )
        return default_cob_id(direction, order, node)


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
