"""The orientation of the sensor: fixed, told by an input, or from the pose of the arm that carries it.

The arm is whatever has CRTK's ``measured_cp``: a device in this process, or one on the far side of ROS. Its
pose is asked for again and again, and counts only while its stamp moves on: an arm that is gone, that says
that its pose is not valid (stamp 0), or that repeats itself gives no orientation.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from typing import Any, Final, Protocol

from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.pipeline import Pipeline
from crtk_drivers.errors import CommandRefused, CrtkError, DataTimeout, Reason
from crtk_drivers.geometry.quaternions import (
    QUATERNION_TOLERANCE,
    matrix_from_quaternion,
    quaternion_from_rotvec,
    unit,
)
from crtk_drivers.samples import Array, Pose, vector

PERIOD: Final = 0.005
"""Seconds between two looks at the arm."""
RETRY: Final = 1.0
"""Seconds between two attempts to find it."""
CONNECT_TIMEOUT: Final = 3.0
"""Seconds of one of them."""
PATIENCE: Final = 0.5
"""Seconds that the thread may take to end; one that is finding the arm ends by itself later."""

_UNASKED: Final = "the arm was not asked yet"

logger = logging.getLogger(__name__)


class Arm(Protocol):
    """What has a pose, as the fronts of this package have it (`crtk_drivers.connect`, and of the client)."""

    def measured_cp(self, age: float, wait: float, extra: bool) -> tuple[Pose, float]:
        """Return the pose and its stamp in s, 0 for one that is not valid.

        Raises:
            DataTimeout: there is none yet.
        """


Finder = Callable[[], Any]
"""Finds an `Arm`; raises CrtkError. What it returns is closed afterwards, if it can be."""


def on_ros(namespace: str) -> Finder:
    """Return what finds the arm in a ROS namespace.

    Raises:
        MissingExtra, ConfigError: ROS 2 cannot be used here.
    """
    from crtk_drivers.client import connect  # a sensor on a bench needs none of it
    from crtk_drivers.ros import environment

    environment.check()
    return lambda: connect(namespace, timeout=CONNECT_TIMEOUT, features=["measured_cp"])


def rotation_of(rotvec: tuple[float, float, float]) -> Array:
    """Return the matrix (3, 3) of a rotation vector in rad."""
    return matrix_from_quaternion(quaternion_from_rotvec(vector(rotvec)))


class ArmFollower:
    """Hands the poses of an arm on, with a thread of its own. It can be stopped and started again.

    Args:
        find: returns the arm; asked again until it does.
        owned: whether to close the arm at the end.
        take: called with each new pose; may raise CrtkError.
        lose: called when the pose is not known any more.
        where: the arm, for messages.

    Attributes:
        problem: why no pose is known, empty if one is.
    """

    def __init__(
        self,
        find: Finder,
        owned: bool,
        take: Callable[[Pose], None],
        lose: Callable[[], None],
        where: str,
    ) -> None:
        self.problem = _UNASKED
        self._find = find
        self._owned = owned
        self._take = take
        self._lose = lose
        self._where = where
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Follow the arm from now on. Does nothing while it runs."""
        if self._thread is not None:
            return
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(self._stop,), name=f"orientation {self._where}", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Follow it no more. May be called twice."""
        self._stop.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(PATIENCE)

    def _run(self, stop: threading.Event) -> None:
        while not stop.is_set():
            arm: Any = None
            try:
                arm = self._find()
                self._follow(arm, stop)
            except CrtkError as error:
                self._lost(stop, str(error))
            except Exception as error:
                logger.exception("%s: following the arm failed; trying again", self._where)
                self._lost(stop, f"{type(error).__name__}: {error}")
            finally:
                if self._owned and arm is not None:
                    arm.close()
            stop.wait(RETRY)

    def _follow(self, arm: Arm, stop: threading.Event) -> None:
        newest = 0.0
        while not stop.wait(PERIOD):
            try:
                pose, stamp = arm.measured_cp(age=0.0, wait=0.0, extra=True)
                if stamp == 0.0:
                    self._lost(stop, "the arm says that its pose is not valid")
                elif stamp != newest and not stop.is_set():
                    newest = stamp
                    self._take(pose)
                    self._found()
            except DataTimeout as error:
                self._lost(stop, error.message)
            except CrtkError as error:
                self._lost(stop, str(error))

    def _found(self) -> None:
        if self.problem:
            logger.info("%s: the orientation is known", self._where)
        self.problem = ""

    def _lost(self, stop: threading.Event, problem: str) -> None:
        if stop.is_set():
            return
        self._lose()
        if self.problem in ("", _UNASKED):
            logger.warning("%s: the orientation is not known: %s", self._where, problem)
        self.problem = problem


class OrientationSource:
    """Tells a pipeline the orientation, and what keeps it from being known.

    Args:
        config: of the device.
        pipeline: that is told.
    """

    def __init__(self, config: NetFtConfig, pipeline: Pipeline) -> None:
        self.has_input = not config.arm and config.orientation is None
        """Whether it is told by the input ``orientation``."""
        self._where = config.host
        self._lasts = config.orientation_timeout
        self._pipeline = pipeline
        self._mounting = rotation_of(config.mounting)
        self._lock = threading.Lock()
        self._running = False
        self._follower: ArmFollower | None = None
        if config.arm:
            self._follower = self._follower_of(on_ros(config.arm), True, config.arm)
        if config.orientation is not None:
            pipeline.set_rotation(rotation_of(config.orientation))

    @property
    def problem(self) -> str:
        """Why the orientation is not known now; empty if it is."""
        if self._pipeline.rotation is not None:
            return ""
        if self._follower is not None and self._follower.problem:
            return self._follower.problem
        return f"no new pose came for {self._lasts:g} s"

    def note(self) -> str:
        """Return what people should know of the compensation; empty if it is as it should be."""
        if self._pipeline.compensation.is_known:
            return ""
        problem = self.problem or "nothing was measured since"
        return f"unavailable, and measured_cf invalid: the orientation is not known: {problem}"

    def take(self, pose: Pose) -> None:
        """Take the pose of the sensor, or of what it is mounted on.

        Raises:
            CommandRefused: it has no rotation.
        """
        length = math.hypot(*pose.orientation.tolist())
        if not abs(length - 1.0) < QUATERNION_TOLERANCE:
            raise CommandRefused(
                "orientation",
                Reason.BAD_QUATERNION,
                f"a quaternion of length {length:.4g}",
                where=self._where,
                remedy="Send x, y, z, w of length 1.",
            )
        rotation = matrix_from_quaternion(unit(pose.orientation)) @ self._mounting
        self._pipeline.set_rotation(rotation, self._lasts)

    def follow(self, arm: Arm | None) -> None:
        """See `NetFtDevice.follow`."""
        with self._lock:
            if self._follower is not None:
                self._follower.stop()
            self._follower = None
            self._pipeline.set_rotation(None)
            if arm is not None:
                self._follower = self._follower_of(lambda: arm, False, "the arm")
                if self._running:
                    self._follower.start()

    def start(self) -> None:
        """The device is open: look for the arm."""
        with self._lock:
            self._running = True
            if self._follower is not None:
                self._follower.start()

    def stop(self) -> None:
        """The device is closed: leave the arm."""
        with self._lock:
            self._running = False
            if self._follower is not None:
                self._follower.stop()

    def _follower_of(self, find: Finder, owned: bool, name: str) -> ArmFollower:
        where = f"ati-netft {self._where}, {name}"
        return ArmFollower(find, owned, self.take, lambda: self._pipeline.set_rotation(None), where)
