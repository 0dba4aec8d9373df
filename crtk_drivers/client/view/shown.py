"""What a page shows of the devices that are watched, as data that JSON can hold, and what it may have done.

A transform is twelve numbers, three rows of rotation and position (m). Values are in SI units.
"""

from __future__ import annotations

import json
import logging
import secrets
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from crtk_drivers.client.view.drawable import traces_of
from crtk_drivers.client.view.newest_values import Seen, joints_in
from crtk_drivers.client.view.pilot import DEADMAN, Pilot, Refused
from crtk_drivers.client.view.places import TF_STATIC, Frames, in_a_row
from crtk_drivers.client.view.watched import WatchedDevice
from crtk_drivers.client.view.watcher import Watcher
from crtk_drivers.errors import CrtkError
from crtk_drivers.errors.wording import worded
from crtk_drivers.kinematics.drawn import numbers_of
from crtk_drivers.kinematics.joint_axes import matrix_of
from crtk_drivers.ros.manifest import headline
from crtk_drivers.samples import Array, Pose, Wrench
from crtk_drivers.state import OperatingState

__all__ = ["Mounted", "ShownDevices"]

logger = logging.getLogger(__name__)

Found = dict[str, Any]
Mounted = Mapping[str, tuple[str, Array]]
"""Of a sensor on an arm, by its namespace: that of the arm, and where it is in its tool frame (4, 4)."""

SCENE_PERIOD: Final = 0.5
"""Seconds after which what does not change is looked at again."""
NOTICES: Final = 6
SMALL: Final = 0.4
"""m that a device without a chain takes in the row."""
HEIGHT: Final = 0.15
"""m above the floor, of the place where the force of a sensor is drawn that nothing carries."""

_LEVELS: Final = ("good", "fair", "bad", "fair")  # as diagnostic_msgs numbers them
_STATES: Final = {
    OperatingState.ENABLED: "good",
    OperatingState.PAUSED: "fair",
    OperatingState.DISABLED: "",
    OperatingState.FAULT: "bad",
}


class ShownDevices:
    """All devices of a watcher. `scene`, `live` and `command` are called by the thread of the page.

    Args:
        watcher: that runs.
        mounted: sensors that are on an arm.
        control: whether pages may command, with the token.
    """

    def __init__(self, watcher: Watcher, mounted: Mounted, control: bool = False) -> None:
        self.secret = secrets.token_urlsafe(24) if control else None
        """The token without which nothing is commanded; None where nothing can be."""
        self.is_over = threading.Event()
        """Whether the server of the page has ended."""
        self._watcher = watcher
        self._mounted = mounted
        self._control = control
        self._frames = Frames()
        self._pilots: dict[str, Pilot] = {}
        self._notices: deque[tuple[float, str]] = deque(maxlen=NOTICES)
        self._version = 0
        self._scene: Found = {}
        self._text = ""
        self._scene_due = 0.0
        watcher.hear(TF_STATIC, "tf2_msgs/msg/TFMessage", self._frames.take)
        if control:
            watcher.on_settled(self._prepare)

    # ----------------------------------------------------------------------------------------- scene

    def scene(self) -> Found:
        """What does not change as long as `version` in `live` is the same."""
        self._watcher.looked()
        self._renew()
        return self._scene

    def _renew(self) -> None:
        self._scene_due = time.monotonic() + SCENE_PERIOD
        devices = list(self._watcher)
        places = self._places(devices)
        found = {
            "title": "CRTK devices",
            "control": self._control,
            "deadman": DEADMAN,
            "devices": [self._device(each, places[each.namespace]) for each in devices],
        }
        text = json.dumps(found)
        if text != self._text:
            self._version += 1
            self._text = text
            self._scene = found | {"version": self._version}

    def _places(self, devices: list[WatchedDevice]) -> dict[str, Array]:
        bases = {
            each.namespace: str((each.manifest.get("frames") or {}).get("base", ""))
            for each in devices
        }
        known = self._frames.places(bases)
        others = [
            each
            for each in devices
            if each.namespace not in known and each.namespace not in self._mounted
        ]
        behind = max((float(at[1, 3]) + SMALL for at in known.values()), default=0.0)
        row = in_a_row([each.chain.reach if each.chain else SMALL for each in others], behind)
        known |= {each.namespace: at for each, at in zip(others, row, strict=True)}
        for name, (carrier, _) in self._mounted.items():
            known[name] = known.get(carrier, np.eye(4))
        return known

    def _device(self, device: WatchedDevice, place: Array) -> Found:
        chain = device.chain
        stop = device.manifest.get("stop") or {}
        pilot = self._pilots.get(device.namespace)
        return {
            "namespace": device.namespace,
            "about": headline(device.manifest),
            "joints": [
                {"name": each["name"], "low": each.get("lower"), "high": each.get("upper")}
                for each in device.manifest.get("joints", ())
            ],
            "chain": None
            if chain is None
            else {
                "names": chain.names,
                "joints": [numbers_of(each) for each in chain.joints],
                "slides": chain.slides,
                "tip": numbers_of(chain.tip),
            },
            "place": numbers_of(place),
            "offered": device.offered,
            "stop": str(stop.get("description", "")),
            "actions": () if pilot is None else pilot.actions,
            "poses": () if pilot is None else pilot.poses,
        }

    # ------------------------------------------------------------------------------------------ live

    def live(self) -> Found:
        """What changes."""
        self._watcher.looked()
        if time.monotonic() >= self._scene_due:
            self._renew()
        devices = list(self._watcher)
        seen = {each.namespace: each.look() for each in devices}
        stamps = [each.wall_ns for values in seen.values() for each in values.values()]
        refusals = sorted(
            (
                (each.at, device.namespace, each.refusal)
                for device in devices
                for each in tuple(device.refusals)
            ),
            key=lambda row: row[0],
        )
        return {
            "version": self._version,
            "sampled": max(stamps, default=0) / 1e6,
            "devices": {each.namespace: self._live(each, seen) for each in devices},
            "refusals": [
                [at, where, refusal.command, worded(refusal.message), worded(refusal.remedy)]
                for at, where, refusal in refusals
            ],
            "notices": list(self._notices),
        }

    def _live(self, device: WatchedDevice, all_seen: Mapping[str, Mapping[str, Seen]]) -> Found:
        seen = all_seen[device.namespace]
        status, silence = device.status(), device.silence()
        state = "silent" if silence else "" if status is None else str(status.state)
        level = "bad" if silence else "" if status is None else _STATES[status.state]
        found: Found = {
            "state": "connecting" if status is not None and status.connecting else state,
            "level": level,
            "homed": None if status is None else status.is_homed,
            "busy": None if status is None else status.is_busy,
            "reason": silence or ("" if status is None else worded(status.detail)),
            "health": self._health(device),
            "old": self._old(seen),
            "traces": {
                name: [
                    [trace.part, trace.unit, trace.names, trace.values]
                    for trace in traces_of(each.value, device.offered.get(name, ""))
                ]
                for name, each in seen.items()
            },
            "jogs": device.namespace in self._pilots and self._pilots[device.namespace].jogs,
        }
        chain, joints = device.chain, joints_in(seen)
        if chain is not None and joints is not None:
            at = dict(zip(joints[0].name, joints[0].position.tolist(), strict=False))
            found["q"] = [at.get(name, 0.0) for name in chain.names]
        tool = _tool(seen)
        if tool is not None:
            found["tool"] = numbers_of(tool)
        found["force"] = self._force(device.namespace, all_seen)
        return found

    def _health(self, device: WatchedDevice) -> list[tuple[str, str, str]]:
        rows = []
        for thing, words, level, values in self._watcher.reports(device.namespace).values():
            rate = values.get("rate (Hz)")
            text = (
                words if rate is None else f"{words}, {rate} of {values['expected rate (Hz)']} Hz"
            )
            rows.append((thing, worded(text), _LEVELS[min(level, 3)] if level else ""))
        return rows

    def _old(self, seen: Mapping[str, Seen]) -> list[str]:
        return [name for name, each in seen.items() if each.is_old]

    def _force(self, namespace: str, seen: Mapping[str, Mapping[str, Seen]]) -> Found | None:
        """Return a force (N) and where it is felt, in the base of the device or of its carrier."""
        felt = seen[namespace].get("measured_cf")
        if felt is None or not isinstance(felt.value, Wrench) or not felt.wall_ns:
            return None
        force = felt.value.force
        if namespace in self._mounted:
            carrier, mounting = self._mounted[namespace]
            tool = _tool(seen.get(carrier, {}))
            at = (np.eye(4) if tool is None else tool) @ mounting
            return {"at": at[:3, 3].tolist(), "vector": (at[:3, :3] @ force).tolist()}
        tool = _tool(seen[namespace])
        at_tool = [0.0, 0.0, HEIGHT] if tool is None else tool[:3, 3].tolist()
        return {"at": at_tool, "vector": force.tolist()}

    # --------------------------------------------------------------------------------------- control

    def command(self, browser: int, arguments: Mapping[str, Any]) -> str:
        """Do something for a page; return why it is not done, empty if it is begun.

        ``{"do": ..., "device": "/ur5"}`` with what `Pilot.do` takes; ``hold`` without a device is for all of
        them, and ``gone`` says that there is no such page any more.
        """
        self._watcher.looked()
        what, where = arguments.get("do"), arguments.get("device")
        if what == "gone":
            for pilot in tuple(self._pilots.values()):
                pilot.gone(browser)
            return ""
        if what == "hold" and where is None:
            for pilot in tuple(self._pilots.values()):
                pilot.hold("hold")
            return ""
        wanted = self._pilots.get(str(where))
        if wanted is None or not isinstance(what, str):
            return f"{where}: it cannot be commanded now: it is not there, or offers nothing"
        try:
            wanted.do(what, browser, arguments)
        except Refused as refused:
            return f"{where}: {refused}"
        except CrtkError as error:
            return str(error)
        return ""

    def watch(self, namespace: str, name: str) -> bool:
        """Look at another value of a device; return whether it is looked at."""
        device = self._watcher.get(namespace)
        return device is not None and device.want(name)

    def ended(self) -> None:
        """The server of the page has ended, and with it all pages: what they began ends."""
        for pilot in tuple(self._pilots.values()):
            pilot.all_gone()
        self.is_over.set()

    def close(self) -> None:
        """End what pages began."""
        for pilot in tuple(self._pilots.values()):
            pilot.close()

    def _prepare(self, device: WatchedDevice) -> None:
        if device.namespace in self._pilots or device.problem:
            return
        pilot = Pilot(device, self._tell)
        if not pilot.actions:
            return
        try:
            pilot.prepare()
        except CrtkError as error:
            logger.warning("%s cannot be commanded yet: %s", device.namespace, error)
            return
        self._pilots[device.namespace] = pilot

    def _tell(self, text: str) -> None:
        logger.info("%s", text)
        self._notices.append((time.time(), worded(text)))


def _tool(seen: Mapping[str, Seen]) -> Array | None:
    found = seen.get("measured_cp")
    if found is None or not isinstance(found.value, Pose) or not found.wall_ns:
        return None
    return matrix_of(found.value)
