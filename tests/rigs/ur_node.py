"""A simulated UR5e on ROS 2, and a client that is connected to it over DDS."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from crtk_drivers.config import NodeConfig
from crtk_drivers.session import Session, open_session
from rigs.loopback_node import served
from rigs.ros_client import RosClient
from rigs.ur_bench import lenient, patient_config
from rigs.waiting import eventually

NOT_ON_A_UR = frozenset({"servo_jf"})
PATIENT = {"frequency": 125.0, "sample_timeout": 3.0}
"""Configuration in which a busy machine is no fault, and does not trip the controller's watchdog. DDS carries
several messages of each sample."""


@dataclass
class UrRig:
    """A served arm and its client."""

    session: Session
    client: RosClient

    def joints(self) -> np.ndarray:
        inbox = self.client["measured_js"]
        return np.array(inbox.wait(since=inbox.mark()).position)

    def enabled(self) -> None:
        """Enable it, once more where a busy machine lets the controller, or its watchdog, end that."""
        eventually(self._is_enabled, "it is enabled")

    def _is_enabled(self) -> bool:
        state = self.client.state.state
        if state == "ENABLED":
            return True
        since = self.client["operating_state"].mark()
        self.client.state_command("resume" if state == "PAUSED" else "enable")
        self.client["operating_state"].wait(lambda m: not m.is_busy, since)
        eventually(lambda: self.session.engine.transition_ended, "it has come to an end")
        return False


@contextmanager
def ur_on_ros(namespace: str) -> Iterator[UrRig]:
    """Serve a simulated arm, and connect a client to it."""
    session = open_session("ur", patient_config(PATIENT), sim=True)
    with (
        lenient(),
        RosClient(namespace, NOT_ON_A_UR) as client,
        served(session, namespace, (), NodeConfig()),
    ):
        client.check_connections()
        yield UrRig(session, client)
