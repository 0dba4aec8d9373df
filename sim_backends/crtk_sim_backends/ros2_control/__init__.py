"""A simulated robot behind ros2_control: a node that behaves as controller_manager and its controllers do.

:data:`SIM` starts it; ``python -m crtk_sim_backends.ros2_control`` runs it alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from typing_extensions import override

from crtk_sim_backends.kit import (
    ConfigError,
    LoopServer,
    Options,
    SimStartError,
    Simulator,
    check_range,
    option,
)
from crtk_sim_backends.page import Gauge, Gauges
from crtk_sim_backends.ros2_control.description import urdf_of
from crtk_sim_backends.ros2_control.joints import JointLimits
from crtk_sim_backends.ros2_control.robot import Robot

__all__ = ["SIM", "Ros2ControlSimulator", "SimConfig"]

TICK: Final = 0.002
"""Seconds between two looks at what came."""
AUTO: Final = "auto"


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """Options of the simulated robot."""

    joints: str = option(
        "joint_1,joint_2,joint_3,joint_4,joint_5,joint_6", "names of its joints, with commas"
    )
    namespace: str = option(
        AUTO,
        "ROS namespace of all that it has; 'auto': one of its own, '/': as most robots have it",
    )
    domain: int = option(-1, "ROS domain; -1: that of the environment")
    rate: float = option(100.0, "rate of joint states and controllers, in Hz")
    keeps_commands: bool = option(
        False, "forward controllers still have an old command when they are activated (#674)"
    )

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("rate", self.rate, 5.0, 1000.0)
        check_range("domain", self.domain, -1, 232)
        names = self.names
        if not names or len(set(names)) < len(names):
            raise ConfigError(f"joints must be names of their own, not {self.joints!r}")
        if self.namespace != AUTO and not self.namespace.startswith("/"):
            raise ConfigError(f"namespace must begin with a slash, not {self.namespace!r}")

    @property
    def names(self) -> tuple[str, ...]:
        """Of the joints."""
        return tuple(name for name in self.joints.split(",") if name)


class Ros2ControlSimulator(Simulator[SimConfig, LoopServer]):
    """The robot as a plug-in."""

    name = "ros2-control"
    summary = (
        "robot behind ros2_control: controller_manager with forward and trajectory controllers"
    )
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Make its node, which is spun by the loop."""
        limits = tuple(JointLimits(name) for name in config.names)
        robot = Robot(limits, config.keeps_commands)
        namespace = _namespace(config)
        server = LoopServer(
            config,
            parent_fd,
            _Shown(robot, namespace),
            title="Robot behind ros2_control",
            gauges=lambda: _gauges(robot),
            requests={"place": robot.place, "joint_limits": robot.told_limits},
        )
        try:
            from crtk_sim_backends.ros2_control.graph.node import Graph

            domain = None if config.domain < 0 else config.domain
            graph = Graph(robot, namespace, domain, urdf_of(limits))
        except ImportError as error:
            server.close()
            needed = "a package of ROS 2, or of the extra ros2-control of crtk-drivers"
            raise SimStartError(f"it lacks {needed}: {error}") from error
        server.at_end(graph.close)
        period = 1.0 / config.rate

        def tick() -> None:
            robot.advance(period)
            graph.tell()

        server.every(period, tick)
        server.every(TICK, graph.spin)
        return server

    @override
    def describe(self, server: LoopServer) -> Iterator[str]:
        """Tell where it is on ROS, too."""
        yield from super().describe(server)
        yield f"ROS namespace: {server.status()['namespace'] or '/'}"


class _Shown:
    """A robot as a device of the kit, which tells where it is as well."""

    def __init__(self, robot: Robot, namespace: str) -> None:
        self._robot = robot
        self._namespace = namespace
        self.kinds = robot.kinds
        self.begin = robot.begin
        self.end = robot.end

    def status(self) -> dict[str, Any]:
        """See `crtk_sim_backends.kit.Device`."""
        return {**self._robot.status(), "namespace": self._namespace}


def _gauges(robot: Robot) -> list[Gauges]:
    rows: list[Gauge] = [
        {
            "name": limit.name,
            "value": position,
            "rate": velocity,
            "low": limit.lower,
            "high": limit.upper,
        }
        for limit, position, velocity in zip(
            robot.limits,
            robot.joints.position.tolist(),
            robot.joints.velocity.tolist(),
            strict=True,
        )
    ]
    return [{"title": "Joints", "unit": "rad", "rate": "rad/s", "digits": 3, "gauges": rows}]


def _namespace(config: SimConfig) -> str:
    if config.namespace == AUTO:
        return f"/sim_robot_{os.getpid()}"
    return config.namespace.rstrip("/")


SIM: Final = Ros2ControlSimulator()
