"""What is wrong with the drives of an arm, by axis and node, and what the others do meanwhile."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from crtk_driver_canopen.arm_link import COLLECT, ArmLink
from crtk_driver_canopen.axis import Axis
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.motion import Motion
from crtk_driver_canopen.statemachine import State
from crtk_driver_canopen.targets import UNHEARD
from crtk_drivers.errors import TransitionFailed

__all__ = ["AGAIN", "Troubles"]

AGAIN: Final = "Remove the cause, and enable again."


class Troubles:
    """Of one arm.

    Args:
        config, link, motion: of it.
        patience: cycles in which the PDOs of a node may come late.
    """

    def __init__(self, config: CanopenConfig, link: ArmLink, motion: Motion, patience: int) -> None:
        self._config = config
        self._link = link
        self._motion = motion
        self._patience = patience

    def told(self, missing: Mapping[int, str], unstopped: Sequence[Axis], now: float) -> str:
        """Return all that is wrong, in words; empty if nothing is.

        Args:
            missing: see `missing`.
            unstopped: axes that move although they were told to stop.
            now: monotonic seconds.
        """
        link = self._link
        found = [text for text in (link.foreign.found(now), self._motion.fault) if text]
        found += [f"node {node} does not get our PDOs" for node in sorted(link.deaf)]
        found += [f"{axis.place} moves although it was told to stop" for axis in unstopped]
        for axis in self._link.axes:
            if axis.config.node in missing:
                continue  # what it said last is not what it is now
            emergency = link.master.emergencies.get(axis.config.node)
            told = f" ({emergency})" if emergency is not None else ""
            if axis.failure:
                found.append(f"{axis.place}: {axis.failure}{told}")
            elif axis.drive.state is State.FAULT:
                found.append(f"{axis.place} is in fault{told}")
        return "; ".join([*found, *(missing[node] for node in sorted(missing))])

    def missing(self, now: float) -> dict[int, str]:
        """Return the nodes of which is not known what they do, with what is known."""
        link = self._link
        in_time = 1000 * COLLECT * self._config.period
        missing = {
            node: f"node {node} sends its PDOs too late: not within {in_time:.3g} ms of any SYNC"
            for node in link.tardy(self._patience)
        }
        missing |= {
            axis.config.node: f"{axis.place} tells that it is at {where.told} counts, where it cannot have "
            f"come to from {where.position}; if it was given another position, switch it off and on, or "
            "start the driver again"
            for axis, where in zip(self._link.axes, link.whereabouts, strict=True)
            if where.strange > UNHEARD
        }
        late = link.late(self._config.missed_cycles)
        missing |= {node: f"node {node} does not send its PDOs" for node in late}
        missing |= {
            node: f"node {node} is not heard any more"
            for node in link.master.watch.lost(now)
            if node in self._config.nodes
        }
        for nodes, what in (
            (link.left, "is not operational any more"),
            (link.restarted, "has started anew"),
        ):
            for node in nodes:
                command = link.foreign.command_to(node)
                why = f" ({command})" if command else ""
                missing[node] = (
                    f"node {node} {what}{why}: it is set up again when the arm is enabled"
                )
        return missing

    def group_policy(self, missing: set[int], *, begins: bool) -> None:
        """One axis has a fault: when it begins, have the others do what is configured.

        A drive of which nothing is known stops: when it hears us again, it may not be where it was.
        """
        goal = {"quick_stop": State.QUICK_STOP, "disable": State.DISABLED}.get(
            self._config.on_joint_fault
        )
        for axis in self._link.axes:
            wanted = goal if begins else None
            if axis.config.node in missing and axis.drive.goal is State.ENABLED:
                wanted = State.QUICK_STOP
            if wanted is not None and axis.is_enabled:
                axis.drive.request(wanted)

    def of_enabling(self, now: float) -> Iterator[TransitionFailed]:
        """Yield what keeps the arm from being enabled, also after its nodes were set up anew."""
        link = self._link
        foreign = link.foreign.found(now)
        if foreign:
            yield TransitionFailed(foreign, where=link.where, remedy=AGAIN)
        missing = self.missing(now)
        strange = [
            missing[axis.config.node]
            for axis, where in zip(link.axes, link.whereabouts, strict=True)
            if where.strange > UNHEARD
        ]
        if strange:
            yield TransitionFailed("; ".join(strange), where=link.where, remedy=AGAIN)
        yield from self.astray()

    def astray(self) -> Iterator[TransitionFailed]:
        """Yield which joints stand beyond all that their range allows: with power, they would hold there."""
        positions = self._link.units.positions(self._link.positions)
        astray = [
            f"{axis.place} tells that it is at {position:.4g}, where no joint of its range can stand "
            f"({axis.config.lower:.4g} to {axis.config.upper:.4g})"
            for axis, position in zip(self._link.axes, positions.tolist(), strict=True)
            if axis.is_astray(position)
        ]
        if astray:
            yield TransitionFailed(
                "; ".join(astray),
                where=self._link.where,
                remedy="Was it moved over the end of its counter, which has 32 bits? Move it back by hand, "
                "or check its encoder, and the gear, offset and range that are configured. One that can be "
                "homed: send unhome, enable and home.",
            )

    def check_home(self, axes: Sequence[Axis]) -> None:
        """See that the home offsets were taken as they were meant.

        Raises:
            TransitionFailed: an axis stands at the negative of its home position.
        """
        positions = dict(zip(self._link.axes, self._link.positions, strict=True))
        mirrored = [axis.place for axis in axes if axis.found_mirrored(positions[axis])]
        if mirrored:
            raise TransitionFailed(
                f"after homing, these stand at the negative of their home position: {', '.join(mirrored)}",
                where=self._link.where,
                remedy="The drive takes the home offset (607Ch) the other way: change `homing.home_offset`.",
            )
