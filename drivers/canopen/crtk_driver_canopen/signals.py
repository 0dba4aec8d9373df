"""What drives are sent and tell, by joint, and where that is among the values of all PDOs. No I/O."""

from __future__ import annotations

from collections.abc import Sequence

from crtk_driver_canopen.axis import Axis
from crtk_driver_canopen.layout import Layout
from crtk_driver_canopen.objects import OBJECTS

__all__ = ["Outputs", "Signals"]

_TOLD = (
    "statusword",
    "position_actual",
    "mode_of_operation_display",
    "velocity_actual",
    "torque_actual",
)
_SENT = (
    "controlword",
    "mode_of_operation",
    "target_position",
    "interpolation_position",
    "target_velocity",
    "target_torque",
)


class Outputs:
    """What all drives are sent with the next SYNC, by joint; counts of the drives.

    Attributes:
        controlword, mode, position, velocity, torque: (n,) lists, to be changed.
    """

    def __init__(self, count: int) -> None:
        self.controlword = [0] * count
        self.mode = [0] * count
        self.position = [0] * count
        self.velocity = [0] * count
        self.torque = [0] * count


class Signals:
    """The values of the joints of an arm.

    Args:
        layout: of the PDOs.
        axes: n joints.

    Attributes:
        position_slots: (n,) the PDO in which each tells where it is, among those of all drives.
    """

    def __init__(self, layout: Layout, axes: Sequence[Axis]) -> None:
        self._places: dict[str, list[int | None]] = {}
        for group, names in ((layout.tpdos, _TOLD), (layout.rpdos, _SENT)):
            for name in names:
                found = group.places(OBJECTS[name])
                self._places[name] = [
                    found.get((axis.config.node, axis.config.axis)) for axis in axes
                ]
        tells = {
            (pdo.node, entry): slot
            for slot, pdo in enumerate(layout.tpdos.pdos)
            for entry in pdo.entries
        }
        position = OBJECTS["position_actual"]
        self.position_slots = [
            tells[axis.config.node, position.on_axis(axis.config.axis)] for axis in axes
        ]
        self._count = sum(len(pdo.entries) for pdo in layout.rpdos.pdos)

    def picked(self, name: str, values: Sequence[int]) -> list[int]:
        """Return one of the values that drives tell, (n,); 0 where one does not."""
        return [0 if place is None else values[place] for place in self._places[name]]

    def shown(self, name: str, values: Sequence[int]) -> list[int | None]:
        """Return one of the values that drives tell, (n,); None where one does not."""
        return [None if place is None else values[place] for place in self._places[name]]

    def measured(self, name: str, values: Sequence[int]) -> list[int] | None:
        """Return one of the values that drives tell, (n,); None unless all do."""
        return None if None in self._places[name] else self.picked(name, values)

    def sent(self, outputs: Outputs, positions: Sequence[int]) -> list[int]:
        """Return the values of all PDOs that drives are sent.

        Args:
            outputs: for all joints.
            positions: (n,) in place of theirs.
        """
        values = [0] * self._count
        columns = (
            outputs.controlword,
            outputs.mode,
            positions,
            positions,
            outputs.velocity,
            outputs.torque,
        )
        for name, column in zip(_SENT, columns, strict=True):
            for place, value in zip(self._places[name], column, strict=True):
                if place is not None:
                    values[place] = value
        return values
