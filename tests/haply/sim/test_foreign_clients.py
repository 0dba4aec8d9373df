"""Other clients of the service, by the unmodified library `websockets`, at the simulated one.

They do what is written of sawHaplyService and of Isaac Lab, in the order in which these do it.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from typing import Any

import pytest
from websockets.asyncio.client import connect as connect_async
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from crtk_sim_backends.haply import RunningSim
from rigs.haply_bench import simulated
from rigs.waiting import LONG, eventually

GRIPS = ("verse_grip", "custom_verse_grip", "wireless_verse_grip")


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with simulated() as running:
        yield running


def place(sim: RunningSim) -> str:
    return f"ws://{sim.host}:{sim.ports['service']}"


def exerted(sim: RunningSim) -> list[float]:
    force: list[float] = sim.control.status()["force"]
    return force


def ask(client: ClientConnection, message: Any) -> Any:
    client.send(json.dumps(message))
    return json.loads(client.recv(LONG))


class Merged:
    """sawHaplyService: it sends in each loop, and merges what comes by device, configuration included."""

    def __init__(self, client: ClientConnection) -> None:
        self._client = client
        self.known: dict[str, dict[str, Any]] = {}

    def take(self) -> None:
        """Merge one message."""
        for name, listed in json.loads(self._client.recv(LONG)).items():
            if isinstance(listed, list):
                for item in listed:
                    self.known.setdefault(f"{name} {item['device_id']}", {}).update(item)

    def loop(self, arm: str, grip: str, commands: dict[str, Any]) -> None:
        """Send the command, and ask a grip of unknown kind in all lists; then take the answer."""
        asked = [{"device_id": grip, "commands": {"probe_orientation": {}}}]
        message: dict[str, Any] = {"inverse3": [{"device_id": arm, "commands": commands}]}
        message |= dict.fromkeys(GRIPS, asked)
        self._client.send(json.dumps(message))
        self.take()


def test_saw_haply_service_sends_first(sim: RunningSim) -> None:
    with connect(place(sim)) as client:
        merged = Merged(client)
        client.send(json.dumps({"session": {"force_render_full_state": {}}}))
        merged.take()
        merged.take()  # what the service tells by itself, and the answer
        arm, grip = merged.known["inverse3 049D"], merged.known["wireless_verse_grip 61548"]
        assert arm["config"]["device_info"]["major_version"] == 7
        assert arm["status"]["calibrated"]
        assert grip["status"]["awake"]
        assert set(grip["state"]["buttons"]) == {"home", "a", "b", "c"}

        merged.loop("049D", "61548", {"probe_position": {}})
        assert exerted(sim) == [0.0, 0.0, 0.0]
        force = {"set_cursor_force": {"values": {"x": 0.5, "y": 0.0, "z": -0.5}}}

        def is_felt() -> bool:
            merged.loop("049D", "61548", {**force, "set_gravity_compensation": True})
            return exerted(sim) == [0.5, 0.0, -0.5]

        eventually(is_felt, "its force")
        assert "config" in merged.known["inverse3 049D"], "it is kept, though it comes once"
        here = arm["state"]["cursor_position"]
        goal = {**here, "y": here["y"] + 0.02}

        def is_there() -> bool:
            merged.loop("049D", "61548", {"set_cursor_position": {"values": goal}})
            there = merged.known["inverse3 049D"]["state"]["cursor_position"]
            return abs(float(there["y"]) - goal["y"]) < 1e-3

        eventually(is_there, "its position")
        zero = {"set_cursor_force": {"values": {"x": 0.0, "y": 0.0, "z": 0.0}}}
        merged.loop("049D", "61548", {**zero, "set_gravity_compensation": False})
        assert exerted(sim) == [0.0, 0.0, 0.0]


def test_isaac_lab_receives_first(sim: RunningSim) -> None:
    felt: list[list[float]] = []

    async def device(force: dict[str, float], rounds: int) -> dict[str, Any]:
        data: dict[str, Any] = {}
        async with connect_async(place(sim), ping_interval=None, ping_timeout=None) as ws:
            for number in range(rounds):
                data = json.loads(await asyncio.wait_for(ws.recv(), LONG))
                if number == 0:
                    arm = data["inverse3"][0]["device_id"]
                    assert data["wireless_verse_grip"][0]["device_id"] == "61548"
                    assert "config" in data["inverse3"][0]
                commands = {"set_cursor_force": {"values": force}}
                await ws.send(json.dumps({"inverse3": [{"device_id": arm, "commands": commands}]}))
                await asyncio.sleep(0.005)
                felt.append(exerted(sim))
        return data

    data = asyncio.run(device({"x": 0.0, "y": 1.0, "z": 0.0}, 10))
    assert [0.0, 1.0, 0.0] in felt
    state = data["wireless_verse_grip"][0]["state"]
    assert {"a", "b", "c"} <= set(state["buttons"])
    assert state["orientation"]["w"] == 1.0
    assert "config" not in data["inverse3"][0], "it is told once"
    eventually(lambda: exerted(sim) == [0.0, 0.0, 0.0], "a client that is gone leaves no force")


def test_one_answer_for_each_message_and_none_besides(sim: RunningSim) -> None:
    with connect(place(sim)) as client:
        client.recv(LONG)
        for _ in range(5):
            client.send("{}")
        for _ in range(5):
            assert json.loads(client.recv(LONG))["inverse3"]
        with pytest.raises(TimeoutError):
            client.recv(0.05)


@pytest.mark.parametrize("text", ["", "no JSON", "[]", '{"inverse3": 3}', "[" * 5000])
def test_nonsense_is_answered_with_the_state_and_moves_nothing(sim: RunningSim, text: str) -> None:
    with connect(place(sim)) as client:
        client.recv(LONG)
        client.send(text)
        assert json.loads(client.recv(LONG))["inverse3"]
        bad = {"set_cursor_force": {"values": {"x": "1", "y": None, "z": 0}}}
        ask(client, {"inverse3": [{"device_id": "049D", "commands": bad}]})
        other = {"set_cursor_force": {"values": {"x": 1.0, "y": 0.0, "z": 0.0}}}
        ask(client, {"inverse3": [{"device_id": "0000", "commands": other}]})
        assert exerted(sim) == [0.0, 0.0, 0.0]


def test_a_ping_is_answered_and_what_is_no_websocket_refused(sim: RunningSim) -> None:
    with connect(place(sim)) as client:
        assert client.ping().wait(LONG)
    with pytest.raises(InvalidStatus, match="426"):
        connect(place(sim), additional_headers={"Upgrade": "h2c"})


def test_the_last_force_goes_on_if_that_is_asked_for() -> None:
    with simulated(idle_after=0.0) as sim, connect(place(sim)) as client:
        client.recv(LONG)
        force = {"set_cursor_force": {"values": {"x": 1.0, "y": 0.0, "z": 0.0}}}
        ask(client, {"inverse3": [{"device_id": "049D", "commands": force}]})
        steps = sim.control.status()["position"]
        eventually(lambda: sim.control.status()["position"] != steps, "it moves")
        assert exerted(sim) == [1.0, 0.0, 0.0]
