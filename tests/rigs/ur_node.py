"""A simulated UR5e on ROS 2, and a client that is connected to it over DDS."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from crtk_drivers import plugins
from crtk_drivers.config import NodeConfig
from crtk_drivers.session import Session, open_session
from rigs.loopback_node import served, until
from rigs.ros_client import RosClient

NOT_ON_A_UR = frozenset({"servo_jf"})
PATIENT = {"sample_timeout": 3.0, "watchdog_frequency": 2.0}
"""Configuration in which a busy machine is no fault, and does not trip the controller's watchdog."""


@dataclass
class UrRig:
    """A served arm and its client."""

    session: Session
    client: RosClient

    def joints(self) -> np.ndarray:
        inbox = self.client["measured_js"]
        return np.array(inbox.wait(since=inbox.mark()).position)

    def enabled(self) -> None:
        if self.client.state.state != "ENABLED":
            self.client.reach("enable", "ENABLED")


@contextmanager
def ur_on_ros(namespace: str) -> Iterator[UrRig]:
    """Serve a simulated arm, and connect a client to it."""
    config = plugins.device("ur").load_config(None, PATIENT)
    session = open_session("ur", config, sim=True)
    with (
        RosClient(namespace, NOT_ON_A_UR) as client,
        served(session, namespace, (), NodeConfig()),
    ):
        client.check_connections()
        until(lambda: session.engine.has_sample, "the arm is connected")
        yield UrRig(session, client)
