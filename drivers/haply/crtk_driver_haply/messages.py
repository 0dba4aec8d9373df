"""The messages of Haply's Inverse service: bytes in, values out, and forces in, bytes out. No I/O, no clock.

Sources: Haply, Inverse SDK 3.5, "WebSocket protocol", "Simulation channel", "Control commands"; of what older
services tell, and for the member ``values`` of a force, sawHaplyService (mtsHaply.cpp) and Isaac Lab
(se3_haply.py). Metres, m/s, newtons; quaternions are x, y, z, w.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NoReturn

__all__ = ["FULL_STATE", "NO_FORCE", "Arm", "ForceMessage", "Grip", "Told", "parse"]

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

NO_FORCE: Final[Triple] = (0.0, 0.0, 0.0)
FULL_STATE: Final = b'{"session":{"force_render_full_state":{}}}'
"""Asks for the configuration and the state of all devices, where the service does not tell them by itself."""

MOST: Final = 100.0
"""m, m/s and N beyond which a number is not of a device that stands on a table."""
GRIPS: Final = ("verse_grip", "wireless_verse_grip", "custom_verse_grip")
"""Lists of VerseGrips: wired, wireless, built by others."""
_CALIBRATED: Final = 2
"""`calibration_state` of older services from which positions count."""
_NORM: Final = 1e-2
"""By how much the norm of a quaternion may differ from one."""


@dataclass(frozen=True, slots=True)
class Arm:
    """An Inverse3 as the service tells it.

    Attributes:
        device_id: of it.
        position: (3,) of the cursor, m.
        velocity: (3,) of the cursor, m/s.
        force: (3,) that the service has it exert, N; None: it does not tell.
        is_calibrated: positions count; true where the service tells nothing of it.
        firmware: version; empty: it does not tell.
    """

    device_id: str
    position: Triple
    velocity: Triple
    force: Triple | None = None
    is_calibrated: bool = True
    firmware: str = ""


@dataclass(frozen=True, slots=True)
class Grip:
    """A VerseGrip as the service tells it.

    Attributes:
        device_id: of it.
        kind: name of its list, one of `GRIPS`.
        orientation: x, y, z, w of unit length; None: it tells none.
        pressed: names of the buttons that are pressed.
        battery: charge, 0 to 1; None: it tells none.
        is_awake: it measures; true where the service tells nothing of it.
    """

    device_id: str
    kind: str
    orientation: Quaternion | None = None
    pressed: frozenset[str] = field(default_factory=frozenset)
    battery: float | None = None
    is_awake: bool = True


@dataclass(frozen=True, slots=True)
class Told:
    """One message: all devices by their ids; `arms` is None where it has no list of Inverse3."""

    arms: Mapping[str, Arm] | None
    grips: Mapping[str, Grip]


def parse(text: bytes) -> Told:
    """Return what a message tells.

    Raises:
        ValueError: no JSON, not of this protocol, or a number that cannot be; with what.
    """
    try:
        message = json.loads(text, parse_constant=_no_number)
    except RecursionError:
        raise ValueError("nested without end") from None
    if not isinstance(message, dict):
        raise ValueError(f"no object: {str(message)[:40]}")
    listed = message.get("inverse3")
    arms = None if listed is None else {arm.device_id: arm for arm in map(_arm, _items(listed))}
    grips = {
        grip.device_id: grip
        for kind in GRIPS
        if kind in message
        for grip in (_grip(kind, item) for item in _items(message[kind]))
    }
    return Told(arms, grips)


class ForceMessage:
    """Messages that ask an Inverse3 for a force, and with it for the state of all devices.

    Args:
        device_id: of the Inverse3.
        grip: whose orientation is asked for, too; None: there is none.
        member: what the three numbers are called.
    """

    def __init__(self, device_id: str, grip: Grip | None, member: str) -> None:
        name = json.dumps(device_id)
        self._before = (
            f'{{"inverse3":[{{"device_id":{name},"commands":{{"set_cursor_force":{{"{member}":{{'
        )
        probe = ""
        if grip is not None:
            probe = (
                f',"{grip.kind}":[{{"device_id":{json.dumps(grip.device_id)},'
                '"commands":{"probe_orientation":{}}}]'
            )
        self._after = f"}}}}}}}}]{probe}}}"

    def of(self, force: Triple) -> bytes:
        """Return the message for a force (3,) in N, of finite numbers."""
        x, y, z = force
        return f'{self._before}"x":{x!r},"y":{y!r},"z":{z!r}{self._after}'.encode()


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number")


def _items(listed: object) -> list[Mapping[str, Any]]:
    if not isinstance(listed, list) or not all(isinstance(item, dict) for item in listed):
        raise ValueError("devices are no list of objects")
    return listed


def _arm(item: Mapping[str, Any]) -> Arm:
    state, status = _part(item, "state"), _part(item, "status")
    told = status.get("calibrated")
    if told is None:
        told = state.get("calibration_state", _CALIBRATED)
        told = isinstance(told, int) and told >= _CALIBRATED
    if not isinstance(told, bool):
        raise ValueError(f"calibrated: {told!r}")
    force = state.get("current_cursor_force")
    config = item.get("config")
    info = config.get("device_info") if isinstance(config, dict) else item.get("device_info")
    return Arm(
        _id(item),
        _triple(state, "cursor_position"),
        _triple(state, "cursor_velocity"),
        None if force is None else _triple(state, "current_cursor_force"),
        told,
        _firmware(info),
    )


def _firmware(info: object) -> str:
    if not isinstance(info, dict):
        return ""
    return f"{info.get('major_version', '?')}.{info.get('minor_version', '?')}"[:20]


def _grip(kind: str, item: Mapping[str, Any]) -> Grip:
    state, status = _part(item, "state"), _part(item, "status")
    awake, buttons = status.get("awake", True), state.get("buttons", {})
    if not isinstance(awake, bool) or not isinstance(buttons, dict):
        raise ValueError("awake is no flag, or buttons are no object")
    battery = state.get("battery_level")
    return Grip(
        _id(item),
        kind,
        _quaternion(state) if "orientation" in state else None,
        frozenset(name for name, pressed in buttons.items() if pressed is True),
        None if battery is None else min(max(_number(battery, "battery_level"), 0.0), 1.0),
        awake,
    )


def _part(item: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    part = item.get(name, {})
    if not isinstance(part, dict):
        raise ValueError(f"{name} is no object")
    return part


def _id(item: Mapping[str, Any]) -> str:
    found = item.get("device_id")
    if not isinstance(found, str) or not found:
        raise ValueError(f"device_id: {str(found)[:40]}")
    return found


def _number(value: object, name: str) -> float:
    if type(value) is not float and type(value) is not int:
        raise ValueError(f"{name}: {str(value)[:40]!r} is no number")
    if not -MOST <= value <= MOST:
        raise ValueError(f"{name}: {str(value)[:40]} cannot be")
    return float(value)


def _triple(state: Mapping[str, Any], name: str) -> Triple:
    part = _part(state, name)
    x, y, z = (_number(part.get(axis), f"{name} {axis}") for axis in "xyz")
    return x, y, z


def _quaternion(state: Mapping[str, Any]) -> Quaternion:
    part = _part(state, "orientation")
    x, y, z, w = (_number(part.get(axis), f"orientation {axis}") for axis in "xyzw")
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1.0) <= _NORM:
        raise ValueError(f"orientation: its norm is {norm:.3g}")
    return x / norm, y / norm, z / norm, w / norm
