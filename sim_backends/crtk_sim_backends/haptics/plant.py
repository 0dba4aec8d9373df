"""The simulated device as the simulator sees it: its fields, its faults, its status."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.page import Gauge, Gauges

MOST: Final = 0.12
"""m that it reaches on each axis."""

_NUMBER: Final = Parameter(float, 0.0, minimum=-100.0, maximum=100.0)
_PLACE: Final = Parameter(float, 0.0, minimum=-MOST, maximum=MOST)

KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind(
            "push",
            "a hand pushes it, in N",
            dict.fromkeys(("x", "y", "z"), _NUMBER),
            lasting=True,
        ),
        FaultKind(
            "hold",
            "a hand holds it at a place, in m",
            dict.fromkeys(("x", "y", "z"), _PLACE),
            lasting=True,
        ),
        FaultKind(
            "press",
            "a button is pressed",
            {"button": Parameter(int, 0, minimum=0, maximum=15)},
            lasting=True,
        ),
        FaultKind("squeeze", "the gripper is squeezed", {"torque": _NUMBER}, lasting=True),
        FaultKind(
            "forces_off",
            "its forces are switched off: 1 by its button, 2 since it was fast, 3 by its watchdog",
            {"cause": Parameter(int, 1, minimum=1, maximum=6)},
        ),
        FaultKind("unplugged", "it is gone: every call fails", lasting=True),
        FaultKind("no_device", "none is there when devices are counted", lasting=True),
        FaultKind("open_fails", "it cannot be opened", lasting=True),
        FaultKind("hang", "every call of the library hangs", lasting=True),
        FaultKind("crash", "the next call of the library ends its process"),
        FaultKind("broken", "it tells positions that are no numbers", lasting=True),
        FaultKind("uncalibrated", "it does not know where it is any more"),
    )
}

_FLAGS: Final = frozenset({"unplugged", "no_device", "open_fails", "hang", "broken"})


class HapticDevice:
    """A device in shared memory.

    Args:
        library: that was built of a C file with ``plant.h``.
        kinds: of faults, beside `KINDS`, which set the field of their name.
    """

    def __init__(self, library: Path, kinds: Mapping[str, FaultKind] | None = None) -> None:
        self._library = ctypes.CDLL(str(library))
        self._library.sim_name.restype = ctypes.c_char_p
        self._library.sim_get.restype = ctypes.c_double
        self._library.sim_set.argtypes = (ctypes.c_int, ctypes.c_double)
        names = itertools.takewhile(bool, map(self._library.sim_name, itertools.count()))
        self._fields = {name.decode(): index for index, name in enumerate(names)}
        self._own = dict(kinds or {})
        self.kinds = {**KINDS, **self._own}

    def get(self, name: str) -> float:
        """Return a field at the present time."""
        return float(self._library.sim_get(self._fields[name]))

    def set(self, **values: float) -> None:
        """Set fields."""
        for name, value in values.items():
            self._library.sim_set(self._fields[name], value)

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        kind, told = fault.kind, fault.parameters
        if kind == "push":
            self.set(push_x=told["x"], push_y=told["y"], push_z=told["z"])
        elif kind == "hold":
            self.set(hand_x=told["x"], hand_y=told["y"], hand_z=told["z"], hand=1.0)
        elif kind == "press":
            self._press(told["button"], True)
        elif kind == "squeeze":
            self.set(squeeze=told["torque"])
        elif kind == "forces_off":
            self.set(force_off_cause=told["cause"], force_on=0.0)  # whoever sees the one knows why
        elif kind == "uncalibrated":
            self.set(initialized=0.0)
        else:
            self.set(**{kind: 1.0})

    def end(self, fault: Fault) -> None:
        """Let it end."""
        kind = fault.kind
        if kind == "push":
            self.set(push_x=0.0, push_y=0.0, push_z=0.0)
        elif kind == "hold":
            self.set(hand=0.0)
        elif kind == "press":
            self._press(fault.parameters["button"], False)
        elif kind == "squeeze":
            self.set(squeeze=0.0)
        elif kind in _FLAGS or kind in self._own:
            self.set(**{kind: 0.0})

    def _press(self, button: int, pressed: bool) -> None:
        mask = 1 << button
        buttons = int(self.get("buttons"))
        self.set(buttons=buttons | mask if pressed else buttons & ~mask)

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        acts = bool(self.get("force_on"))
        return {
            "position": [self.get(name) for name in ("x", "y", "z")],
            "velocity": [self.get(name) for name in ("vx", "vy", "vz")],
            "force": [acts * self.get(name) for name in ("fx", "fy", "fz")],
            "torque": [acts * self.get(name) for name in ("tx", "ty", "tz")],
            "gripper": self.get("gripper"),
            "gripper_force": acts * self.get("gripper_force"),
            "forces_on": acts,
            "force_off_cause": int(self.get("force_off_cause")),
            "strongest": self.get("strongest"),
            "impulse": self.get("impulse"),
            "gravity_compensation": bool(self.get("is_gravity_compensated")),
            "initialized": bool(self.get("initialized")),
            "homing": bool(self.get("homing")),
            "regulated": bool(self.get("regulated")),
            "sent": [self.get(name) for name in ("fx", "fy", "fz")],
            "watchdog": self.get("watchdog"),
            "opened_by": int(self.get("opened_by")),
            "sets": int(self.get("sets")),
        }

    def gauges(self) -> list[Gauges]:
        """What the page shows."""
        shown: list[Gauge] = [
            {"name": axis, "low": -MOST, "high": MOST, "value": self.get(axis)}
            for axis in ("x", "y", "z")
        ]
        return [{"title": "Position", "unit": "m", "rate": "", "digits": 4, "gauges": shown}]
