"""A foreign client, pyigtl: it sees a device and commands it through the bridge."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import crtk_drivers
from rigs.igtl_peer import at, served
from rigs.waiting import LONG, eventually

pyigtl = pytest.importorskip("pyigtl")


@pytest.fixture
def arm() -> Iterator[Any]:
    with crtk_drivers.connect("loopback") as front:
        yield front


@pytest.mark.parametrize("version", [1, 2])
def test_it_sees_and_commands_a_device(arm: Any, version: int) -> None:
    with served({"arm": arm}, version=version) as (_, server):
        client = pyigtl.OpenIGTLinkClient("127.0.0.1", server.port)
        try:
            seen = client.wait_for_message("arm/measured_cp", timeout=LONG)
            assert np.allclose(seen.matrix, np.eye(4), atol=1e-3)
            assert seen.metadata == ({"unit": "mm", "frame_id": "base"} if version == 2 else {})
            client.send_message(pyigtl.StringMessage("enable", device_name="arm/state_command"))
            eventually(arm.is_enabled, "it is enabled")
            goal = at(30.0, 40.0, -50.0)
            client.send_message(pyigtl.TransformMessage(goal, device_name="arm/move_cp"))

            def is_there() -> bool:
                message = client.wait_for_message("arm/setpoint_cp", timeout=LONG)
                return np.allclose(message.matrix, goal, atol=1e-3)

            eventually(is_there, "the goal")
            client.send_message(pyigtl.StringMessage("resume", device_name="arm/state_command"))
            refusal = client.wait_for_message("arm/error", timeout=LONG)
            assert "invalid_transition" in refusal.string
        finally:
            client.stop()
