"""A driver in a process of its own that does something until it is killed: for F16."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from typing import Any

from bench.reliability.activities import Activity, Plan
from crtk_drivers import plugins
from crtk_drivers.errors import CommandRefused
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session


def main() -> None:
    """Connect, enable, do it."""
    options, activity = json.loads(sys.argv[1]), sys.argv[2]
    plugin = plugins.device(options["plugin"])
    session = Session(plugin, plugin.load_config(options["config"], {}))
    arm: Any = LocalDevice(session)
    session.start()
    while not (session.engine.connected and session.engine.has_sample):
        time.sleep(0.01)
    arm.enable(20.0)
    doing = Activity(activity, arm, Plan(**options["plan"]))
    while True:
        with contextlib.suppress(CommandRefused):
            doing.send()
        time.sleep(0.002)


if __name__ == "__main__":
    main()
