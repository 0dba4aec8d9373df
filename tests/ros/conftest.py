"""Fixtures: a device on ROS 2 with a client.

They live as long as a test file: ROS needs up to three seconds until two ends have found each other. Each
test gets the device back at zero, connected and DISABLED.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from ros_rig import Rig, rig_of


@pytest.fixture(scope="module")
def shared_rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    with rig_of(f"/{request.module.__name__}") as rig:
        yield rig


@pytest.fixture
def rig(shared_rig: Rig) -> Rig:
    shared_rig.reset()
    return shared_rig
