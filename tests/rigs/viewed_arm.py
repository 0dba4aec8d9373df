"""A virtual arm on ROS 2, and all devices of the graph as a page shows them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np

from crtk_driver_virtual import PLUGIN
from crtk_driver_virtual.config import VirtualConfig
from crtk_drivers import plugins
from crtk_drivers.client.view import pilot
from crtk_drivers.client.view.shown import Mounted, ShownDevices
from crtk_drivers.client.view.watcher import Watcher
from crtk_drivers.engine import Engine
from crtk_drivers.plugins.page_plugin import start_page
from crtk_drivers.samples import JointState, Vector
from crtk_drivers.session import Session
from rigs.loopback_node import served
from rigs.view_page import ViewPage, device_of
from rigs.waiting import eventually

PATIENT = 3600.0
"""Seconds after the last word of a page at which a jog ends: by its time only where that is tested."""

STILL = 0.05
"""Seconds between two samples, at least, that tell whether it stands."""


@dataclass
class Viewed:
    """The arm, its engine, and the page.

    Attributes:
        address: of the page, with its token if there is one.
    """

    namespace: str
    engine: Engine
    watcher: Watcher
    shown: ShownDevices
    page: Any
    address: str

    def joints(self) -> JointState:
        return self._measured()[0]

    def _measured(self) -> tuple[JointState, float]:
        """Return the newest joint state, and when (monotonic, s) it was measured."""
        found = self.engine.feedback("measured_js")
        assert found is not None
        assert isinstance(found[0], JointState)
        return found[0], found[1].monotonic

    def ready(self) -> None:
        """Enable it, and wait until it stands; what pages that have gone began is over, with its hold."""
        eventually(lambda: not self._is_piloted(), "what pages began has ended")
        eventually(lambda: self.engine.transition_ended, "what was begun has ended")
        self.engine.state_command("disable")
        eventually(lambda: self.engine.transition_ended, "it is disabled")
        self.engine.state_command("enable")
        eventually(lambda: self.engine.status.state == "ENABLED", "it is enabled")
        self.stands()

    def _is_piloted(self) -> bool:
        """Whether a thread of its pilot runs: a page may be noticed to be gone only when the next is open."""
        return any(each.name.endswith(f" {self.namespace}") for each in threading.enumerate())

    def stands(self) -> None:
        """Wait until it does not move any more, and nothing is sent to it."""

        def is_still() -> bool:
            before, began = self._measured()
            eventually(lambda: self._measured()[1] - began > STILL, "it is measured later, too")
            now = self.joints().position
            still = np.allclose(before.position, now, rtol=0.0, atol=1e-7)
            health, status = self.engine.health(), self.engine.status
            return still and not (self._is_piloted() or health.stream != "" or status.is_busy)

        eventually(is_still, "it stands")

    def moves(self, start: Vector | None = None) -> None:
        """Wait until it moves; `start` is where it was, for what may be over before anybody looks."""
        before = self.joints().position if start is None else start
        eventually(lambda: bool(np.abs(self.joints().position - before).max() > 1e-3), "it moves")


@contextmanager
def viewed_arm(
    namespace: str, control: bool = True, mounted: Mounted | None = None, **config: Any
) -> Iterator[Viewed]:
    """Serve an arm and the page, in this process."""
    with ExitStack() as opened:
        opened.enter_context(patch.object(pilot, "DEADMAN", PATIENT))
        session = Session(PLUGIN, VirtualConfig(transition_time=0.0, rate=100.0, **config))
        opened.enter_context(served(session, namespace))
        watcher = opened.enter_context(Watcher([namespace]))
        shown = opened.enter_context(closing(ShownDevices(watcher, mounted or {}, control)))
        page = start_page(plugins.page("view"), shown, 0)
        opened.callback(page.stop)
        secret = f"#{shown.secret}" if shown.secret else ""
        viewed = Viewed(namespace, session.engine, watcher, shown, page, f"{page.address}{secret}")
        with ViewPage(viewed.address) as browser:
            browser.until(
                lambda scene: _is_known(device_of(scene, namespace), control), ViewPage.scene
            )
        yield viewed


def _is_known(device: Any, control: bool) -> bool:
    return bool(device and device["chain"] and (device["actions"] or not control))
