"""Ways to stop drives beside their PDOs, and how they are found and left.

A stop goes by PDO, as everything in the cycle. A drive that does not follow it is told by SDO to stop
quickly, then its node is stopped by NMT, and at last our heartbeat ends: each needs less of the drive than
the one before.
"""

from __future__ import annotations

import logging
import struct
import time
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol

from crtk_driver_canopen.axis import Axis
from crtk_driver_canopen.frames import Frame
from crtk_driver_canopen.heartbeat import NmtCommand, NmtState, ensure_heartbeat
from crtk_driver_canopen.jobs import NodeJobs
from crtk_driver_canopen.master import Master
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.pdo import Pdo, set_deadline
from crtk_driver_canopen.read_once import Readings
from crtk_driver_canopen.sdo import Sdo, SdoAborted
from crtk_driver_canopen.statemachine import POWERED, Control, State, decode
from crtk_driver_canopen.units import read_unit_objects, resolve
from crtk_drivers.errors import ConfigError, CrtkError, DeviceError

if TYPE_CHECKING:
    from crtk_driver_canopen.config import CanopenConfig
    from crtk_driver_canopen.joint_config import JointConfig

logger = logging.getLogger(__name__)

RPDO_TIMEOUT: Final = 0x8250
"""Error code of a drive that has missed its PDOs for longer than their deadline (14xxh:5)."""

_STAGE: Final = 0.3
"""Seconds that a drive has to stop by one way before the next one is tried."""

_LOOK: Final = 0.05
"""Seconds between two looks at where a drive is, by which it is told whether it moves."""

_STILL: Final = 4
"""Counts that a drive that stands may differ by between them, at least."""

_SLOW: Final = 0.02
"""Part of the greatest velocity of a joint below which one that holds counts as standing."""

_QUICK_STOP_TIME: Final = 1.0
"""Seconds for a drive that was found in motion to stop quickly."""


class Drives(Protocol):
    """What the ways to stop need of the link to the drives.

    Attributes:
        axes: of the arm.
    """

    axes: list[Axis]

    @property
    def where(self) -> str:
        """The bus, for messages."""

    @property
    def master(self) -> Master:
        """Everything on the bus but PDOs."""

    @property
    def left(self) -> set[int]:
        """Nodes that tell that they are not operational, although they were started."""

    @property
    def deaf(self) -> set[int]:
        """Nodes that tell that our PDOs do not reach them."""

    def rpdos(self, node: int) -> list[Pdo]:
        """Return what a node is sent."""


class LastResort:
    """Stops drives that do not do what their PDOs say. Belongs to the I/O thread.

    Args:
        link: the drives.
    """

    def __init__(self, link: Drives) -> None:
        self._link = link
        self._jobs = NodeJobs()
        self._since: dict[int, float] = {}
        self._stage: dict[int, int] = {}

    def reset(self, deadline: float) -> None:
        """Forget everything: the bus is opened anew."""
        self._jobs.join(deadline)
        self._since, self._stage = {}, {}

    def step(self, unstopped: Sequence[Axis], now: float) -> None:
        """Go on with those that hear no PDOs, and those that move although they were told to stop.

        A node that went pre-operational behind our back hears no PDO any more; in a velocity mode it would
        run on, for what it does at a lost connection (6007) does not cover this.

        Args:
            unstopped: axes that move.
            now: monotonic seconds.
        """
        moving = {axis.config.node for axis in unstopped}
        nodes = self._left | self._link.deaf | moving
        self._since = {node: self._since.get(node, now) for node in nodes}
        self._stage = {node: self._stage.get(node, 0) for node in nodes}
        for axis in unstopped:
            if axis.is_enabled:
                axis.drive.request(State.QUICK_STOP)
        new = {node for node in nodes if not self._stage[node]}
        if new and not self._jobs.running:
            self._jobs.start({node: partial(_stop_quickly, self._sdos(node)) for node in new})
            self._stage |= dict.fromkeys(new, 1)
        for node in moving:
            waited = now - self._since[node]
            if self._stage[node] == 1 and waited > _STAGE:
                self._next(node, "its node is stopped by NMT")
                self._link.master.command(NmtCommand.STOP, node)
            elif self._stage[node] == 2 and waited > 2 * _STAGE:
                self._next(node, "our heartbeat ends, so that all drives stop")
                self._link.master.silent = True

    def _next(self, node: int, what: str) -> None:
        self._stage[node] += 1
        logger.error(
            "%s: node %d moves although it was told to stop: %s", self._link.where, node, what
        )

    @property
    def _left(self) -> set[int]:
        nodes = self._link.master.watch.nodes
        return {node for node in self._link.left if nodes[node].state == NmtState.PRE_OPERATIONAL}

    def _sdos(self, node: int) -> list[Sdo]:
        axes = [axis.config.axis for axis in self._link.axes if axis.config.node == node]
        return [Sdo(self._link.master.sdo(node), axis) for axis in axes]


def quick_stop_frame(node: int, axis: int) -> Frame:
    """Return the SDO that tells an axis to stop quickly: an expedited download (CiA 301, 7.2.4.3.3)."""
    entry = OBJECTS["controlword"].on_axis(axis)
    data = struct.pack("<BHBHxx", 0x2B, entry.index, entry.sub, Control.QUICK_STOP)
    return Frame(0x600 + node, data)


def _stop_quickly(axes: Iterable[Sdo]) -> None:
    for sdo in axes:
        try:
            sdo.write(OBJECTS["controlword"], Control.QUICK_STOP)
        except CrtkError as error:
            logger.warning("a drive could not be told to stop: %s", error)


class _Found:
    """An axis as it was found, before anything was written into it."""

    def __init__(self, name: str, joint: JointConfig, sdo: Sdo) -> None:
        self.place = f"{name} (node {joint.node})"
        self.sdo = sdo
        self.powered = self.enabled = self.moved = False
        self._position = 0
        self._still = _least_motion(name, joint, sdo)
        self.look()

    def look(self) -> None:
        """Read what it does; whether it moved is known from the second time on."""
        state = decode(self.sdo.read(OBJECTS["statusword"]))
        self.powered, self.enabled = state in POWERED, state is State.ENABLED
        position = self.sdo.read(OBJECTS["position_actual"])
        self.moved = abs(position - self._position) > self._still
        self._position = position

    def command(self, word: Control) -> None:
        """Send a controlword; a drive that takes none from us is told of once its PDOs are there."""
        try:
            self.sdo.write(OBJECTS["controlword"], word)
        except SdoAborted as error:
            logger.warning("%s: %s", self.place, error)

    def hold(self) -> None:
        """Let its target be where it holds, before its mode may change."""
        demand = self.sdo.find(OBJECTS["position_demand"])
        target = self._position if demand is None else demand
        try:
            self.sdo.write(OBJECTS["target_position"], target)
        except SdoAborted as error:
            logger.debug("%s: %s", self.place, error)  # one without positions


def _least_motion(name: str, joint: JointConfig, sdo: Sdo) -> float:
    """Return by how many counts a joint that moves differs between two looks."""
    try:
        count = abs(resolve(name, joint, read_unit_objects(sdo)).position)
    except ConfigError:
        return _STILL  # its units are told by what is still to be written
    return max(_STILL, _SLOW * joint.velocity * _LOOK / count)


def secure(
    link: Drives, config: CanopenConfig, readings: Readings
) -> tuple[dict[str, str], frozenset[str]]:
    """Bring drives that have power or move to rest, by SDO, before they are set up.

    Those that hold still keep their power where the configuration leaves drives holding (``on_close: hold``);
    the others lose it once they stand: nothing of ours has given it.

    Returns:
        In what state each joint was found, in words, by name, for those that had power or moved; and the
        names of those that hold on.

    Raises:
        SdoSilent, SdoAborted, ProtocolError, BusLost: a drive does not answer.
    """
    axes = {
        name: _Found(name, joint, readings.sdo(joint.node, joint.axis))
        for name, joint in config.joints.items()
    }
    link.master.poll(time.monotonic() + _LOOK)
    for axis in axes.values():
        axis.look()
    told: dict[str, str] = {}
    held: set[str] = set()
    for name, axis in axes.items():
        if axis.enabled and not axis.moved and config.on_close == "hold":
            axis.hold()
            held.add(name)
            told[name] = f"{axis.place} has power and holds"
        elif axis.powered:
            moved = " and moved: it was stopped, and" if axis.moved else ":"
            told[name] = f"{axis.place} had power{moved} it was taken"
        elif axis.moved:
            told[name] = f"{axis.place} moves without power"
    _take_power([axis for name, axis in axes.items() if axis.powered and name not in held], link)
    return told, frozenset(held)


def _take_power(axes: Sequence[_Found], link: Drives) -> None:
    moving = [axis for axis in axes if axis.moved]
    for axis in moving:
        axis.command(Control.QUICK_STOP)
    deadline = time.monotonic() + _QUICK_STOP_TIME
    while any(axis.moved and axis.powered for axis in moving) and time.monotonic() < deadline:
        link.master.poll(time.monotonic() + _LOOK)
        for axis in moving:
            axis.look()
    for axis in axes:
        axis.command(Control.DISABLE_VOLTAGE)


def leave_holding(link: Drives, config: CanopenConfig) -> None:
    """Leave drives that hold still as they are: what would stop them without us is switched off.

    Pre-operational they need no SYNC and no PDO. That they hold is read back.

    Raises:
        BusLost: the bus cannot be used.
    """
    nodes: Mapping[int, list[Axis]] = {
        node: [axis for axis in link.axes if axis.config.node == node and axis.is_enabled]
        for node in config.nodes
    }
    for node, axes in nodes.items():
        if not axes:
            continue
        sdo = Sdo(link.master.sdo(node))
        try:
            link.master.command(NmtCommand.PRE_OPERATIONAL, node)
            for pdo in link.rpdos(node):
                set_deadline(sdo, pdo, 0)
            produced = round(1000 * config.heartbeat.drives)
            ensure_heartbeat(sdo, produced_ms=produced, watched=config.master_node, watched_ms=0)
            for axis in axes:
                _check_held(axis, Sdo(sdo.port, axis.config.axis))
        except DeviceError as error:
            logger.error(
                "%s: %s: it may not hold for longer than %g s",
                link.where,
                error,
                config.heartbeat.ours_timeout,
            )


def _check_held(axis: Axis, sdo: Sdo) -> None:
    state = decode(sdo.read(OBJECTS["statusword"]))
    if state is not State.ENABLED:
        raise DeviceError(f"{axis.place} was to be left holding, but is {state or 'in no state'}")
