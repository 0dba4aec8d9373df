"""The real command, ``crtk-driver``, with a note of the time at a few places.

cycles        monotonic time at the end of each I/O cycle
samples       controller's time stamp, monotonic and wall time (ns) at which it was received
milestones    monotonic time of: command imported, simulator runs, device made and ROS loaded, node made,
              connected, first sample; the first column is the number of the milestone
"""

from __future__ import annotations

import time

START = time.monotonic()

from collections.abc import Callable  # noqa: E402 - the first line is measured
from typing import Any  # noqa: E402

from bench.recording import Recording  # noqa: E402
from crtk_drivers.cli import device_command, launch, main  # noqa: E402

MILESTONES = ("interpreter", "imports", "simulator", "opened", "node", "connected", "sample")


def after(owner: Any, name: str, note: Callable[..., None]) -> None:
    """Call `note` with the arguments and the result of each call of ``owner.name``."""
    original = getattr(owner, name)

    def noted(*arguments: Any, **options: Any) -> Any:
        result = original(*arguments, **options)
        note(result, *arguments)
        return result

    setattr(owner, name, noted)


def record() -> None:
    """Put the notes in place."""
    cycles, samples = Recording("cycles", 1), Recording("samples", 3)
    milestones = Recording("milestones", 2)
    reached: set[str] = set()

    def reach(name: str, when: float | None = None) -> None:
        if name not in reached:
            reached.add(name)
            milestones.add((MILESTONES.index(name), when or time.monotonic()))

    def sampled(sample: Any, maker: Any, state: Any, *_: Any) -> None:
        reach("sample")
        samples.add((state.timestamp, state.received, sample.stamp.wall_ns))

    def opened(session: Any, *_: Any) -> None:
        from crtk_driver_ur.samples import SampleMaker
        from crtk_drivers.engine import Engine
        from crtk_drivers.ros import serving
        from crtk_drivers.status.health import HealthRecorder

        reach("opened")
        after(serving.Serving, "__init__", lambda *_: reach("node"))
        after(Engine, "connect", lambda *_: reach("connected"))
        after(HealthRecorder, "cycle", lambda _, recorder, now: cycles.add((now,)))
        after(SampleMaker, "make", sampled)

    reach("interpreter", START)
    reach("imports")
    after(launch.Launch, "open", lambda *_: reach("simulator"))
    after(device_command, "opened", opened)


if __name__ == "__main__":
    record()
    raise SystemExit(main())
