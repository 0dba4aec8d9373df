"""The loop of a teleoperation: it hears, steps the states, and sends, until it is told to end."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any, Final

from crtk_drivers.client.remote import RemoteDevice, connect
from crtk_drivers.client.ros_link import Link
from crtk_drivers.client.teleop.pedals import Pedal
from crtk_drivers.client.teleop.side import Listened, nothing
from crtk_drivers.motion.teleop import Commands, Coupled, Heard, Inputs, Side, TeleopSettings, step
from crtk_drivers.motion.teleop.machine import NO_FORCE, STANDING, Phase, rested, stands
from crtk_drivers.samples import JointState, Pose, vector
from crtk_drivers.status.stop_request import StopRequest

logger = logging.getLogger(__name__)

STAND_TIMEOUT: Final = 5.0
"""Seconds in which the follower must be seen to stand after the last hold."""
LOOK_PERIOD: Final = 0.01


class Teleoperation:
    """A leader and a follower. One thread calls `run`; values arrive in the one that spins.

    Args:
        settings: who leads, how, and by which pedals.
        leader: connected.
        follower: connected.
        pedals: as ``clutch`` and ``engage``; those of the settings, however they are read.

    Raises:
        ConfigError: a device lacks what it needs for this.
        ConnectionFailed: nobody is at the other end of a topic.

    Attributes:
        coupled: how they are; made anew by each step.
        steps: how many there were.
    """

    def __init__(
        self,
        settings: TeleopSettings,
        leader: RemoteDevice,
        follower: RemoteDevice,
        pedals: Mapping[str, Pedal],
    ) -> None:
        self.settings = settings
        self.coupled = Coupled()
        self.steps = 0
        self._pedals = dict(pedals)
        self._woken = threading.Event()
        self._has_moved = False
        moved = "servo_cp" if settings.mode == "position" else "servo_cv"
        felt = () if settings.force is None else (settings.force.source,)
        pushed = () if settings.force is None else ("servo_cf",)
        led = ("measured_cv",) if settings.mode == "velocity" else ("measured_cp",)
        freed = ("free",) if settings.free_leader else ()
        self._moved = moved
        self._wrench = felt[0] if felt else "measured_cf"
        with ExitStack() as stack:

            def listened(*wanted: Any) -> Listened:
                side = Listened(*wanted)
                stack.callback(side.close)
                return side

            self._leader = listened(leader, led, (), (*pushed, *freed), ("hold",), self._woken.set)
            self._follower = listened(
                follower, ("measured_cp", *felt), ("setpoint_cp",), (moved,), ("hold",), nothing
            )
            self._leader_gripper = self._jaw = None
            if settings.gripper is not None:
                hand = leader.child(settings.gripper.leader)
                jaw = follower.child(settings.gripper.follower)
                self._leader_gripper = listened(hand, ("measured_js",), (), (), (), nothing)
                self._jaw = listened(
                    jaw, ("measured_js",), ("setpoint_js",), ("servo_jp",), (), nothing
                )
            self._hears_no_more = stack.pop_all()
        if "hold" not in self._follower.takes:
            logger.warning(
                "%s does not offer hold: it stays where the last %s sends it",
                self._follower.namespace,
                moved,
            )

    def run(self, stop: threading.Event | StopRequest, told: Callable[[Coupled], None]) -> None:
        """Step as often as the settings say, each time when the leader has just told something.

        Args:
            stop: set by another thread, by a signal handler, or by `told`.
            told: called after each step; must return soon.
        """
        period = 1.0 / self.settings.rate
        due = time.monotonic()
        while not stop.is_set():
            time.sleep(max(0.0, due - time.monotonic()))
            self._woken.clear()
            self._woken.wait(0.5 * period)  # for what the leader tells next, which is newest then
            due = max(due + period, time.monotonic())
            self.step()
            told(self.coupled)

    def step(self) -> Commands:
        """Hear, step the states, and send. Return what was sent."""
        clutch, engage = (self._pedals.get(name) for name in _PEDALS)
        heard = Inputs(
            time.monotonic(),
            self._leader.read(),
            self._follower.read(self._wrench),
            clutch=None if clutch is None else clutch.read(),
            engage=None if engage is None else engage.read(),
            leader_gripper=Side() if self._leader_gripper is None else self._leader_gripper.read(),
            jaw=Side() if self._jaw is None else self._jaw.read(),
            doubt=next(filter(None, (pedal.doubt for pedal in self._pedals.values())), ""),
        )
        before = self.coupled
        self.coupled, commands = step(self.settings, self.coupled, heard)
        self.steps += 1
        self._send(commands)
        if (self.coupled.phase, self.coupled.trouble) != (before.phase, before.trouble):
            level = logging.WARNING if self.coupled.phase is Phase.HELD else logging.INFO
            logger.log(level, "%s  %s", self.coupled.phase, self.coupled.reason)
        return commands

    def _send(self, commands: Commands) -> None:
        if commands.follower is not None:
            self._has_moved = True
            self._follower.send(self._moved, commands.follower)
        if commands.jaw is not None and self._jaw is not None:
            self._jaw.send("servo_jp", JointState(vector((commands.jaw,))))
        if commands.hold_follower:
            self._follower.send("hold")
        if commands.hold_leader:
            self._hold_leader()
        if commands.free_leader:
            self._leader.send("free")
        if commands.leader is not None:
            self._leader.send("servo_cf", commands.leader)

    def _hold_leader(self) -> None:
        """Hold it. One that takes no hold is at least pushed no more."""
        if "hold" in self._leader.takes:
            self._leader.send("hold")
        elif self.settings.force is not None:
            self._leader.send("servo_cf", NO_FORCE)

    def end(self) -> str:
        """Hold both, and return why it is not known that the follower stands; empty if it was seen to.

        A side that was sent nothing is not held: somebody else may move it.
        """
        if self.settings.force is not None:
            self._leader.send("servo_cf", NO_FORCE)
        if self._has_moved:
            if self.settings.mode != "position":
                self._follower.send(self._moved, STANDING)
            self._follower.send("hold")
        if self._has_moved or self.settings.force is not None or self.settings.free_leader:
            self._leader.send("hold")
        self.coupled = Coupled()
        return self._seen_to_stand()

    def _seen_to_stand(self) -> str:
        """Wait until the follower has stayed where it is for a while."""
        begun = time.monotonic()
        rest: Heard[Pose] | None = None
        while time.monotonic() < begun + STAND_TIMEOUT:
            heard = self._follower.read()
            if heard.lost:
                return f"{self._follower.namespace} is lost: {heard.lost}"
            if heard.pose is not None and heard.pose.since >= begun:
                rest = rested(rest, heard.pose)
                if stands(rest, heard.pose):
                    return ""
            time.sleep(LOOK_PERIOD)
        return f"{self._follower.namespace} was not seen to stand in {STAND_TIMEOUT:g} s"

    def close(self) -> None:
        """Hear nothing more. `end` comes first."""
        self._hears_no_more.close()


_PEDALS: Final = ("clutch", "engage")


@contextmanager
def reached_sides(
    leader: str, follower: str, timeout: float
) -> Iterator[tuple[Link, RemoteDevice, RemoteDevice]]:
    """Two devices on one node, and the link to ROS that they share.

    Args:
        leader: its namespace.
        follower: its namespace.
        timeout: seconds in which each must be found.

    Raises:
        MissingExtra, ConfigError: ROS 2 cannot be used here.
        ConnectionFailed: one is not there; says which are.
    """
    link = Link("crtk_teleop")
    try:
        link.start()
        with (
            connect(leader, timeout=timeout, node=link.node) as first,
            connect(follower, timeout=timeout, node=link.node) as second,
        ):
            yield link, first, second
    finally:
        link.close()
