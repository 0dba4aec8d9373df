"""Many simulated devices in one process, on ROS 2 in one context: the peer of `bench.many_devices`.

    python -m bench.together arm=ur gantry=loopback

Prints ``ready`` when all measure; on SIGUSR1 one line of JSON, the report of each device. Runs until SIGTERM.
"""

from __future__ import annotations

import json
import logging
import signal
import sys
import threading
import time
from contextlib import ExitStack
from dataclasses import asdict

from crtk_drivers import plugins
from crtk_drivers.labs.reports import Report
from crtk_drivers.ros.environment import share_no_memory
from crtk_drivers.session import Session, open_session

share_no_memory()

from crtk_drivers.ros.serving import Serving  # noqa: E402 - the transport is chosen before

LOOK_PERIOD = 0.05


def reports(sessions: dict[str, Session]) -> dict[str, Report]:
    """Return how each device is."""
    engines = {name: session.engine for name, session in sessions.items()}
    return {name: Report.of(engine.status, engine.health()) for name, engine in engines.items()}


def main() -> None:
    """Serve until SIGTERM."""
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr)
    ended, asked = threading.Event(), threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    signal.signal(signal.SIGUSR1, lambda *_: asked.set())
    sessions: dict[str, Session] = {}
    with ExitStack() as stack:
        for argument in sys.argv[1:]:
            name, _, plugin = argument.partition("=")
            config = plugins.device(plugin).config(name=name)
            sessions[name] = open_session(plugin, config, sim=bool(plugins.device(plugin).sim))
            stack.callback(sessions[name].close)
        (first, leading), *others = sessions.items()
        children = {name: session.engine for name, session in others}
        serving = stack.enter_context(Serving(leading.engine, f"/{first}", children=children))
        for session in sessions.values():
            session.start()
        spinning = threading.Thread(target=serving.spin, args=(ended,), name="executor")
        spinning.start()
        stack.callback(spinning.join)
        while not ended.is_set() and not all(each.measures for each in reports(sessions).values()):
            time.sleep(LOOK_PERIOD)
        sys.stdout.write(f"ready {time.monotonic()}\n")
        sys.stdout.flush()
        while not ended.wait(LOOK_PERIOD):
            if asked.is_set():
                asked.clear()
                told = {name: asdict(report) for name, report in reports(sessions).items()}
                sys.stdout.write(f"{json.dumps(told)}\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
