"""A process that serves a loopback device, for tests of signals and exits.

Usage: serve_loopback.py NAMESPACE [--block] [ROS arguments]

It says "held" when the device has been closed. With --block its publishing thread says "blocked" when it
first looks who listens, and stays there for ever, as a DDS writer can.
"""

from __future__ import annotations

import sys
import threading
from typing import Any

from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros import topics
from crtk_drivers.ros.serving import run
from crtk_drivers.session import Session
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice


def say(word: str) -> None:
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


class TalkingDevice(LoopbackDevice):
    """Says when it is left alone."""

    def close(self) -> None:
        super().close()
        say("held")


def block(*arguments: Any) -> Any:
    say("blocked")
    threading.Event().wait()


def main() -> int:
    namespace, *ros_args = sys.argv[1:]
    if "--block" in ros_args:
        ros_args.remove("--block")
        topics.FeedbackTopics._look = block  # type: ignore[method-assign]
    plugin = DevicePlugin("loopback", "says when it is held", LoopbackConfig, TalkingDevice)
    return run(Session(plugin, LoopbackConfig()), namespace, ros_args)


if __name__ == "__main__":
    sys.exit(main())
