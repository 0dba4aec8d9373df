"""What nodes answered while an arm is set up: each object is read once, and again once it may be another.

Several parts of the set-up ask for the same objects, and each answer costs a round trip on the bus.
"""

from __future__ import annotations

from typing import Final

from crtk_driver_canopen.master import Master
from crtk_driver_canopen.objects import OBJECTS, first_axis
from crtk_driver_canopen.sdo import MISSING, WRITE_ONLY, Sdo, SdoAborted, SdoPort, aborted

_CHANGING: Final = frozenset(
    OBJECTS[name].index
    for name in (
        "error_register",
        "number_of_errors",
        "error_code",
        "statusword",
        "mode_of_operation_display",
        "position_demand",
        "position_actual",
        "velocity_demand",
        "velocity_actual",
        "torque_actual",
        "following_error_actual",
        "digital_inputs",
    )
)
"""Objects that a drive changes by itself: each look at them counts."""

_COMMUNICATION: Final = range(0x1000, 0x2000)
"""Objects of CiA 301: one of them changes nothing but itself."""

_SCALING: Final = frozenset(
    {0x6075, 0x6076, 0x607E, *range(0x608F, 0x6098), 0x60A8, 0x60A9, 0x60AA}
)
"""Ratings, polarity, factors and units (CiA 402-2): what they change may read as another number."""

_ALONE: Final = frozenset(entry.index for entry in OBJECTS.values()) - _SCALING
"""Objects that change nothing else; of any other, as those of the maker or of the motor, nobody knows."""


class ReadOnce:
    """The transfers of one node: what it has answered is not asked again before something is written.

    A write forgets the whole object, with all its sub-indices; one that may change others forgets all.

    Args:
        port: carries out the transfers.
    """

    def __init__(self, port: SdoPort) -> None:
        self._port = port
        self._answers: dict[tuple[int, int], bytes | int] = {}

    @property
    def where(self) -> str:
        """The node and its bus, for errors."""
        return self._port.where

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object; see `SdoPort.upload`."""
        key = index, subindex
        answer = self._answers.get(key)
        if answer is None:
            answer = self._ask(index, subindex)
            if first_axis(index) not in _CHANGING:
                self._answers[key] = answer
        if isinstance(answer, int):
            raise aborted(self.where, "read", index, subindex, answer)
        return answer

    def _ask(self, index: int, subindex: int) -> bytes | int:
        """Return the bytes of an object, or the abort code that says for good that it cannot be read."""
        try:
            return self._port.upload(index, subindex)
        except SdoAborted as error:
            if error.code not in MISSING | WRITE_ONLY:
                raise
            return error.code

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write the bytes of an object; see `SdoPort.download`."""
        if index not in _COMMUNICATION and first_axis(index) not in _ALONE:
            self._answers.clear()
        self._answers = {key: each for key, each in self._answers.items() if key[0] != index}
        self._port.download(index, subindex, data)


class Readings:
    """What the nodes of a bus answered in one set-up.

    What a node answered before it started anew is forgotten.

    Args:
        master: of the open bus.
    """

    def __init__(self, master: Master) -> None:
        self._master = master
        self._ports: dict[int, tuple[int, ReadOnce]] = {}

    def sdo(self, node: int, axis: int = 0) -> Sdo:
        """Return the objects of an axis of a node, each of which is read once."""
        life = self._master.watch.nodes.get(node)
        starts = 0 if life is None else life.boot_ups
        known = self._ports.get(node)
        if known is None or known[0] != starts:
            known = self._ports[node] = starts, ReadOnce(self._master.sdo(node))
        return Sdo(known[1], axis)
