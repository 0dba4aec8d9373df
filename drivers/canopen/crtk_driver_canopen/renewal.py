"""Drives that are set up while the others go on with their cycle: after a new start, or for limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial

from crtk_driver_canopen.arm_link import NMT_TIME, ArmLink
from crtk_driver_canopen.axis import Axis
from crtk_driver_canopen.commissioning import prepare
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.heartbeat import NmtCommand
from crtk_driver_canopen.jobs import one_by_one
from crtk_driver_canopen.sdo import Sdo
from crtk_drivers.device import Steps
from crtk_drivers.errors import ConnectionLost, CrtkError, DataTimeout, TransitionFailed

__all__ = ["Renewal"]


class Renewal:
    """Of the drives of one arm. Its procedures belong to the I/O thread; transfers have threads of their own.

    Args:
        config, link: of the arm.
    """

    def __init__(self, config: CanopenConfig, link: ArmLink) -> None:
        self._config = config
        self._link = link

    def give_limits(self, axes: Iterable[Axis]) -> Steps:
        """Have drives hold limits (607D) in which their joints stand: beyond them one would move with power.

        Raises:
            TransitionFailed: a drive does not answer as it should.
        """
        link = self._link
        positions = dict(zip(link.axes, link.positions, strict=True))
        wanted = {axis: axis.limits_here(positions[axis]) for axis in axes}
        if not wanted:
            return
        yield from link.jobs.until_over()
        nodes: dict[int, list[Callable[[], None]]] = {}
        for axis, limits in wanted.items():
            sdo = Sdo(link.master.sdo(axis.config.node), axis.config.axis)
            write = partial(axis.give_limits, sdo, limits)
            nodes.setdefault(axis.config.node, []).append(write)
        link.jobs.start({node: partial(one_by_one, writes) for node, writes in nodes.items()})
        yield from link.jobs.until_over()
        if link.jobs.errors:
            raise self._failed(link.jobs.errors[0])

    def set_up_again(self, note: Callable[[set[int]], None]) -> Steps:
        """Set up the nodes that are not as they were left, and again those that start meanwhile.

        Args:
            note: is told which nodes have been.

        Raises:
            TransitionFailed: one is another device, does not answer, or does not start.
        """
        while nodes := self._changed():
            starts = self._starts(nodes)
            try:
                yield from self._set_up(nodes)
                note(nodes)
            except ConnectionLost:
                raise
            except CrtkError as error:
                if self._starts(nodes) == starts:
                    raise self._failed(error) from error

    def _failed(self, error: CrtkError) -> CrtkError:
        """Return an error as one of a procedure, but for that of a bus that is gone."""
        if isinstance(error, ConnectionLost):
            return error
        where = error.where or self._link.where
        return TransitionFailed(error.message, where=where, remedy=error.remedy)

    def _changed(self) -> set[int]:
        link = self._link
        lost = link.master.watch.lost(time.monotonic())
        nodes = link.restarted | link.left | link.late(self._config.missed_cycles)
        return nodes | (set(lost) & set(self._config.nodes))

    def _starts(self, nodes: set[int]) -> int:
        """How many times these nodes have started, all together."""
        return sum(self._link.master.watch.nodes[node].boot_ups for node in nodes)

    def _set_up(self, nodes: set[int]) -> Steps:
        link, config = self._link, self._config
        yield from link.jobs.until_over()  # those of an enable that was given up
        link.restarted -= nodes
        link.foreign.forget_commands(nodes)
        for node in nodes:
            link.master.command(NmtCommand.PRE_OPERATIONAL, node)
        link.jobs.start(
            {
                node: partial(prepare, link.master, config, link.layout, [node], link.lowered)
                for node in nodes
            }
        )
        yield from link.jobs.until_over()
        if link.jobs.errors:
            link.restarted |= nodes
            raise link.jobs.errors[0]
        yield from self._start(nodes)

    def _start(self, nodes: set[int]) -> Steps:
        """Start nodes, and wait until they send their PDOs."""
        link = self._link
        for axis, where in zip(link.axes, link.whereabouts, strict=True):
            if axis.config.node in nodes:
                where.forget()
        for node in nodes:
            link.master.command(NmtCommand.START, node)
            link.master.watch.nodes[node].state = None
        deadline = time.monotonic() + NMT_TIME
        while nodes & (link.left | link.late(0)):
            if time.monotonic() > deadline:
                link.restarted |= nodes
                raise DataTimeout(
                    f"no PDOs come from node {', '.join(map(str, sorted(nodes & link.late(0))))}, "
                    "although it was set up again",
                    where=link.where,
                    remedy="Does it start again and again? Check its power supply.",
                )
            yield
        now = time.monotonic()
        for node in nodes:
            link.master.watch.nodes[node].seen = now
