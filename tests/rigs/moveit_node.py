"""A device on ROS 2 that serves MoveIt, and clients of its actions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory

from crtk_drivers.config import NodeConfig
from crtk_drivers.engine import Engine
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from rigs.action_client import ActionAsker
from rigs.loopback_node import served
from rigs.waiting import eventually

MOVEIT = NodeConfig(moveit=True)


class MoveItRig:
    """A served device and an action client."""

    def __init__(self, session: Session, asker: ActionAsker, space: str) -> None:
        self.session = session
        self.asker = asker
        self.space = space

    @property
    def engine(self) -> Engine:
        return self.session.engine

    @property
    def names(self) -> tuple[str, ...]:
        return self.engine.capabilities.joints

    def joints(self) -> np.ndarray:
        found = self.engine.feedback("measured_js")
        assert found is not None
        return np.array(found[0].position)  # type: ignore[union-attr]

    def reach(self, command: str, state: OperatingState) -> None:
        self.engine.state_command(command)
        eventually(
            lambda: self.engine.transition_ended and self.engine.status.state is state,
            f"{command} leads to {state}",
        )

    def enabled(self) -> MoveItRig:
        if self.engine.status.state is not OperatingState.ENABLED:
            self.reach("enable", OperatingState.ENABLED)
        return self


@contextmanager
def moveit_rig(
    session: Session,
    space: str,
    node: NodeConfig = MOVEIT,
    kind: Any = FollowJointTrajectory,
    action: str = "follow_joint_trajectory",
) -> Iterator[MoveItRig]:
    """Serve a session, and connect an action client."""
    with served(session, space, (), node), ActionAsker(kind, f"{space}/{action}") as asker:
        yield MoveItRig(session, asker, space)
