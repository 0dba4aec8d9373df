"""Which objects this driver writes from other keys: `parameters` of a joint must not name them too.

What is written twice is lost the first time; so it is refused, with the key that says the same.
"""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

from crtk_driver_canopen.modes import OpMode
from crtk_driver_canopen.objects import object_text, parse_object


class _Joint(Protocol):
    """The configuration of a joint, with its option codes beside."""

    @property
    def op_modes(self) -> tuple[OpMode, ...]: ...
    @property
    def homing(self) -> object | None: ...


class _Owned(NamedTuple):
    """Objects of one use, and the keys from which they are written."""

    objects: tuple[tuple[int, int | None], ...]
    keys: str


_RAMPS: Final = _Owned(
    ((0x6083, 0), (0x6084, 0)),
    "the limit `acceleration`; give its unit by `acceleration_scale` or `ramp_time_scale`",
)
_MOVES: Final = _Owned(((0x6081, 0),), "the limit `velocity`; give its unit by `velocity_scale`")
_CYCLES: Final = _Owned(((0x60C2, None),), "`period`")
_OPTIONS: Final = {
    "abort_option": 0x6007,
    "quick_stop_option": 0x605A,
    "shutdown_option": 0x605B,
    "disable_option": 0x605C,
    "halt_option": 0x605D,
    "fault_option": 0x605E,
}
_HOMING: Final = {
    "speed_switch": (0x6099, 1),
    "speed_zero": (0x6099, 2),
    "acceleration": (0x609A, 0),
    "position": (0x607C, 0),
}
_CYCLIC: Final = frozenset({OpMode.CSP, OpMode.CSV, OpMode.CST, OpMode.IP})


def _owned(joint: _Joint, *, moves: bool) -> list[_Owned]:
    found = []
    if moves or OpMode.PV in joint.op_modes:
        found += [_RAMPS, _MOVES]
    if _CYCLIC & set(joint.op_modes):
        found.append(_CYCLES)
    found += [
        _Owned(((index, 0),), f"`{key}`")
        for key, index in _OPTIONS.items()
        if getattr(joint, key) is not None
    ]
    if joint.homing is not None:
        found += [
            _Owned((place,), f"`homing.{key}`")
            for key, place in _HOMING.items()
            if getattr(joint.homing, key) is not None
        ]
    return found


def written_otherwise(text: str, joint: _Joint, *, moves: bool) -> str:
    """Return why an object cannot be one of the `parameters` of a joint, in words; empty if it can.

    Args:
        text: the object, as `parameters` has it.
        joint: its configuration.
        moves: the drives plan moves themselves.
    """
    index, sub = parse_object(text)
    for owned in _owned(joint, moves=moves):
        if (index, sub) in owned.objects or (index, None) in owned.objects:
            return (
                f"{object_text(index, sub)} is written from {owned.keys}, and would be overwritten"
            )
    return ""
