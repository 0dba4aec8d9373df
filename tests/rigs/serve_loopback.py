"""A process that serves a loopback device, for tests of signals and exits.

Usage: serve_loopback.py NAMESPACE [--block] [--old SECONDS] [ROS arguments]

It says "held" when the device has been closed. With --block its publishing thread says "blocked" when it
first looks who listens, and stays there for ever, as a DDS writer can. With --old its samples are that old
when the driver gets them, and have the stamps of when they were taken.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from typing import Any

from typing_extensions import override

from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros import topics
from crtk_drivers.ros.serving import run
from crtk_drivers.samples import Sample, Stamp
from crtk_drivers.session import Session
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice


def say(word: str) -> None:
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


class TalkingDevice(LoopbackDevice):
    """Says when it is left alone.

    Attributes:
        old: seconds since its samples were taken.
    """

    old = 0.0

    @override
    def read(self, deadline: float) -> Sample | None:
        sample = super().read(deadline)
        if sample is None:
            return None
        taken = sample.stamp
        stamp = Stamp(taken.wall_ns - round(1e9 * self.old), taken.monotonic - self.old)
        return replace(sample, stamp=stamp)

    @override
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
    if "--old" in ros_args:
        at = ros_args.index("--old")
        _, old = ros_args[at : at + 2]
        del ros_args[at : at + 2]
        TalkingDevice.old = float(old)
    plugin = DevicePlugin("loopback", "says when it is held", LoopbackConfig, TalkingDevice)
    return run(Session(plugin, LoopbackConfig()), namespace, ros_args)


if __name__ == "__main__":
    sys.exit(main())
