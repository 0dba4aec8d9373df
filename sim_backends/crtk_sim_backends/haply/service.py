"""The Inverse service: what it is told in JSON, and what it answers. No socket.

Written from Haply's manual of Inverse SDK 3.5 ("WebSocket protocol", "Simulation channel", "Control
commands") and from its clients (Isaac Lab, sawHaplyService): the first message has configuration, state and
status of all devices, and then each message of a client is answered with one of state and status. A command
is applied once; a client that sends none leaves the device idle.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from crtk_sim_backends.haply.config import SimConfig
from crtk_sim_backends.haply.handle import NONE, STEP, Handle, Triple
from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.page import Gauge, Gauges

_PUSH: Final = Parameter(float, 0.0, minimum=-50.0, maximum=50.0)
LISTS: Final = {
    "wireless": "wireless_verse_grip",
    "wired": "verse_grip",
    "custom": "custom_verse_grip",
}
BUTTONS: Final = ("a", "b", "c", "home")

KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind(
            "push", "a hand pushes the handle, in N", {"x": _PUSH, "y": _PUSH, "z": _PUSH}, True
        ),
        FaultKind(
            "press",
            "a button of the grip is pressed",
            {"button": Parameter(str, "a", choices=BUTTONS)},
            lasting=True,
        ),
        FaultKind("vanish", "the Inverse3 is unplugged", lasting=True),
        FaultKind("no_grip", "the grip is switched off", lasting=True),
        FaultKind("asleep", "the grip sleeps", lasting=True),
        FaultKind("uncalibrated", "the Inverse3 is not calibrated", lasting=True),
        FaultKind(
            "battery",
            "the charge of the grip is low",
            {"level": Parameter(float, 0.05, minimum=0.0, maximum=1.0)},
            lasting=True,
        ),
        FaultKind("foreign", "another service answers: JSON without these devices", lasting=True),
        FaultKind("malformed", "answers are no JSON", lasting=True),
        FaultKind("nan", "positions are NaN", lasting=True),
        FaultKind("huge", "numbers are beyond measure", lasting=True),
        FaultKind("half", "the second half of each answer is missing", lasting=True),
        FaultKind("fragments", "answers come in frames of 50 bytes", lasting=True),
        FaultKind("more", "answers have members that nobody knows", lasting=True),
        FaultKind("mute", "messages are not answered", lasting=True),
        FaultKind("deaf", "forces are not exerted", lasting=True),
        FaultKind("stuck", "the last force goes on, whatever is commanded", lasting=True),
        FaultKind("turn", "the grip turns about z at 1 rad/s", lasting=True),
    )
}


class Service:
    """One service with its devices.

    Args:
        config: its options.
    """

    kinds = KINDS

    def __init__(self, config: SimConfig) -> None:
        self.config = config
        self.handle = Handle(config.mass, config.damping, config.radius)
        self.faults: dict[str, Mapping[str, Any]] = {}
        self.commanded_at = -math.inf
        self.messages = 0
        self.refused = 0
        self._yaw = 0.0
        self._pressed: list[str] = []
        self._now: Callable[[], float] = time.monotonic
        self._seen: Triple = NONE
        self._changed_at = self._now()
        self._impulse = 0.0

    # ------------------------------------------------------------------------------------- its devices

    def step(self) -> None:
        """Let `STEP` pass."""
        idle = self.config.idle_after
        if idle and self._now() - self.commanded_at > idle and "stuck" not in self.faults:
            self.handle.let_go()
        if "vanish" in self.faults:
            self.handle.let_go()
        self.handle.step()
        self._impulse += STEP * math.hypot(*self.handle.motors)
        if "turn" in self.faults:
            self._yaw += STEP
        self._look()

    def _look(self) -> None:
        """Remember since when the motors exert what they do."""
        if self.handle.motors != self._seen:
            self._seen, self._changed_at = self.handle.motors, self._now()

    # -------------------------------------------------------------------------------------- messages

    def inventory(self) -> list[bytes]:
        """Return the frames' data of the first message."""
        return self._sent(self._told(full=True))

    def obey(self, text: bytes) -> list[bytes]:
        """Take a message; return the data of the frames of its answer."""
        self.messages += 1
        full = False
        try:
            message = json.loads(text)
            session = message.get("session", {})
            full = "force_render_full_state" in session
            for item in message.get("inverse3", []):
                if item.get("device_id") == self.config.device_id:
                    self._command(item.get("commands", {}))
        except (ValueError, TypeError, AttributeError, KeyError, RecursionError):
            self.refused += 1
        self._look()
        return [] if "mute" in self.faults else self._sent(self._told(full))

    def _command(self, commands: Mapping[str, Any]) -> None:
        if self.faults.keys() & {"vanish", "stuck"}:
            return
        if "set_cursor_force" in commands:
            self._push(_vector(commands["set_cursor_force"], ("values", "vector")))
        elif "set_cursor_position" in commands:
            target = _vector(commands["set_cursor_position"], ("values", "position"))
            self.commanded_at = self._now()
            self.handle.target = None if self._is_limp else target

    def _push(self, force: Triple) -> None:
        self.commanded_at = self._now()
        if self._is_limp:
            self.handle.let_go()
        else:
            self.handle.push(force)

    @property
    def _is_limp(self) -> bool:
        return bool(self.faults.keys() & {"deaf", "uncalibrated"})

    def _told(self, full: bool) -> dict[str, Any]:
        if "foreign" in self.faults:
            return {"jsonrpc": "2.0", "result": "pong"}
        told: dict[str, Any] = {"session_id": 7} if self.config.version == "3.5" else {}
        told["inverse3"] = [] if "vanish" in self.faults else [self._inverse3(full)]
        if self.config.grip != "none":
            there = [] if "no_grip" in self.faults else [self._verse_grip(full)]
            told[LISTS[self.config.grip]] = there
        if "more" in self.faults:
            told["sdf"] = {"hfx": [1, None, {"deep": []}]}
            for item in told["inverse3"]:
                item["state"]["transform"] = {"scale": {"x": 1}}
        return told

    def _inverse3(self, full: bool) -> dict[str, Any]:
        handle = self.handle
        state: dict[str, Any] = {
            "cursor_position": _xyz(handle.position),
            "cursor_velocity": _xyz(handle.velocity),
        }
        item: dict[str, Any] = {"device_id": self.config.device_id, "state": state}
        is_calibrated = "uncalibrated" not in self.faults
        info: dict[str, Any] = {"device_type": 4, "major_version": 7, "minor_version": 4}
        if self.config.version == "3.5":
            item["status"] = {"calibrated": is_calibrated}
            idle = handle.target is None and not any(handle.motors)
            state["current_cursor_force"] = _xyz(handle.motors)
            state["control_mode"] = "idle" if idle else "force"
            info = {"device_info": info, "handedness": "right"}
            if full:
                item["config"] = info
        else:
            state["calibration_state"] = 2 if is_calibrated else 0
            item |= info if full else {}
        if "nan" in self.faults:
            state["cursor_position"] = _xyz((math.nan, 0.0, 0.0))
        if "huge" in self.faults:
            state["cursor_velocity"] = _xyz((1e300, 0.0, 0.0))
        return item

    def _verse_grip(self, full: bool) -> dict[str, Any]:
        half = 0.5 * self._yaw
        item: dict[str, Any] = {
            "device_id": self.config.grip_id,
            "state": {
                "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)},
                "buttons": {name: name in self._pressed for name in BUTTONS},
                "battery_level": self.faults.get("battery", {"level": 0.9})["level"],
            },
            "status": {"awake": "asleep" not in self.faults},
        }
        if full:
            item["config"] = {"type": LISTS[self.config.grip]}
        return item

    def _sent(self, told: Mapping[str, Any]) -> list[bytes]:
        text = json.dumps(told).encode()
        if "malformed" in self.faults:
            text = b"{" + text
        if "half" in self.faults:
            text = text[: len(text) // 2]
        if "fragments" in self.faults:
            return [text[at : at + 50] for at in range(0, len(text), 50)]
        return [text]

    # ----------------------------------------------------------------------------------------- its faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin, a hand push, or a button be pressed."""
        self.faults[fault.kind] = fault.parameters
        if fault.kind == "push":
            x, y, z = (fault.parameters[axis] for axis in "xyz")
            self.handle.hand = (x, y, z)
        elif fault.kind == "press":
            self._pressed.append(fault.parameters["button"])

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self.faults.pop(fault.kind, None)
        if fault.kind == "push":
            self.handle.hand = NONE
        elif fault.kind == "press" and fault.parameters["button"] in self._pressed:
            self._pressed.remove(fault.parameters["button"])

    def put(self, position: list[float]) -> None:
        """Let the handle be somewhere else (3,), at rest."""
        x, y, z = map(float, position)
        self.handle.put((x, y, z))

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {
            "position": list(self.handle.position),
            "velocity": list(self.handle.velocity),
            "force": list(self.handle.motors),
            "force_since": self._changed_at,
            "impulse": self._impulse,
            "messages": self.messages,
            "refused": self.refused,
        }

    def gauges(self) -> list[Gauges]:
        """What the page shows."""
        shown: list[Gauge] = [
            {"name": axis, "low": -0.3, "high": 0.3, "value": value}
            for axis, value in zip("xyz", self.handle.position, strict=True)
        ]
        forces: list[Gauge] = [
            {"name": axis, "low": -10.0, "high": 10.0, "value": value}
            for axis, value in zip("xyz", self.handle.motors, strict=True)
        ]
        return [
            {"title": "Handle", "unit": "m", "rate": "", "digits": 3, "gauges": shown},
            {"title": "Force", "unit": "N", "rate": "", "digits": 2, "gauges": forces},
        ]


def _xyz(values: Triple) -> dict[str, float]:
    return dict(zip("xyz", values, strict=True))


def _vector(command: Mapping[str, Any], names: tuple[str, ...]) -> Triple:
    """Return the three numbers of a command, by whichever of its names clients use."""
    part = next(command[name] for name in names if name in command)
    x, y, z = (float(part[axis]) for axis in "xyz")
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError("not finite")
    return x, y, z
