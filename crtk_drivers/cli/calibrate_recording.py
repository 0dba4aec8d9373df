"""What ``crtk-driver calibrate`` measures: poses of running devices, in motion or where they stand."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final

import numpy as np

from crtk_drivers.cli.reaching import need, reached
from crtk_drivers.cli.terminal import ERR, plain
from crtk_drivers.errors import DataTimeout
from crtk_drivers.geometry.quaternions import rotated
from crtk_drivers.labs.calibration.stillness import Still, StillPoses
from crtk_drivers.samples import Array, Pose

if TYPE_CHECKING:
    from crtk_drivers.client import RemoteDevice

PERIOD: Final = 0.02
"""Seconds between two readings."""
AGE: Final = 0.2
"""Seconds that a pose may be old."""
LONGEST: Final = 600.0
"""Seconds to wait for the next place where something stands."""
TOUCHED: Final = Still(apart=5e-3, apart_turned=10.0, turned=0.03)
"""A pointer at a point of a model: it is another one by where it is, not by how the pointer is held."""
STOOD: Final = Still()

Reading = tuple[float, tuple[Pose, ...] | None]
"""Monotonic seconds, and a pose of each device; None where one is not seen."""


def moving(namespace: str, seconds: float, timeout: float) -> list[Pose]:
    """Return the poses of a device for so many seconds, each once.

    Raises:
        ConnectionFailed, ConfigError: it is not there, or tells none.
    """
    poses: list[Pose] = []
    with ExitStack() as stack, ERR.status("") as status:
        device = _opened(stack, namespace, timeout)
        end = time.monotonic() + seconds
        for now, seen in _readings((device,)):
            if now > end:
                break
            if seen is not None and (not poses or seen[0] is not poses[-1]):
                poses.append(seen[0])
            told = "" if seen is not None else ", not seen now"
            status.update(f"{len(poses)} poses, {end - now:.0f} s left{told}")
    return poses


def touched(namespace: str, count: int, tip: Sequence[float], timeout: float) -> Array:
    """Return where the tip of a pointer stood, one place after the other, (count, 3) in m.

    Raises:
        ConnectionFailed, ConfigError, DataTimeout: see `standing`.
    """
    places = standing((namespace,), count, timeout, "touch the next point", TOUCHED)
    return np.array([pose.position + rotated(pose.orientation, *tip) for (pose,) in places])


def standing(
    namespaces: Sequence[str], count: int, timeout: float, what: str, still: Still = STOOD
) -> list[tuple[Pose, ...]]:
    """Return the poses of devices in places where all of them stood.

    Args:
        namespaces: of the devices.
        count: of places.
        timeout: seconds in which the devices must be found.
        what: the user is to do between two places.
        still: what counts as standing.

    Raises:
        ConnectionFailed, ConfigError: one is not there, or tells no poses.
        DataTimeout: no place for `LONGEST` seconds.
    """
    found: list[tuple[Pose, ...]] = []
    with ExitStack() as stack, ERR.status("") as status:
        devices = [_opened(stack, namespace, timeout) for namespace in namespaces]
        taker, end = StillPoses(still), time.monotonic() + LONGEST
        for now, seen in _readings(devices):
            means = taker.feed(now, seen)
            if means is not None:
                found.append(means)
                end = now + LONGEST
                ERR.bell()
                ERR.print(f"{len(found)} of {count} taken")
            if len(found) == count:
                break
            if now > end:
                raise DataTimeout(
                    f"nothing stood anew for {LONGEST:g} s; {len(found)} of {count} were taken",
                    where=" and ".join(namespaces),
                    remedy="Are all of them seen? See `crtk-driver echo`.",
                )
            status.update(f"{what}; it is taken when it stands" if seen else "one is not seen")
    return found


def _opened(stack: ExitStack, namespace: str, timeout: float) -> RemoteDevice:
    device = stack.enter_context(reached(namespace, timeout))
    need(device, "measured_cp")
    device.check_connections(timeout)
    ERR.print(f"{plain(device.namespace)} is there")
    return device


def _readings(devices: Sequence[RemoteDevice]) -> Iterator[Reading]:
    """Yield what they measure, without an end."""
    while True:
        try:
            seen = tuple(device.measured_cp(age=AGE, wait=0.0) for device in devices)
        except DataTimeout:
            yield time.monotonic(), None
        else:
            yield time.monotonic(), seen
        time.sleep(PERIOD)
