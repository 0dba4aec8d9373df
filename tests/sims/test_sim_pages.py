"""The page of every simulator: what it tells the browser, and that its buttons do what they say."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest

from crtk_drivers.cli.device_command import _tell_page
from crtk_sim_backends.can import SIM as CAN
from crtk_sim_backends.canopen import SIM as CANOPEN
from crtk_sim_backends.control import ControlError, token
from crtk_sim_backends.dynamixel import SIM as DYNAMIXEL
from crtk_sim_backends.netft import SIM as NETFT
from crtk_sim_backends.process import RunningSim
from crtk_sim_backends.ur import SIM as UR
from crtk_sim_backends.watching import pictures
from rigs.waiting import LONG

SIMS: dict[str, tuple[Any, dict[str, Any]]] = {
    "can": (CAN, {"socketcand_port": 0, "bitrate": 500_000}),
    "canopen": (CANOPEN, {"nodes": 2, "axes": 2}),
    "dynamixel": (DYNAMIXEL, {"servos": "1:xl430-w250,2:ax-12a;7:xl330-m288"}),
    "netft": (
        NETFT,
        {"rdt_port": 0, "tcp_port": 0, "http_port": 0, "load": "constant:fz=-20,ty=2"},
    ),
    "ur": (UR, {}),
}
WITH_TOKEN = {"Authorization": f"Bearer {token()}"}


@pytest.fixture(scope="module", params=SIMS)
def sim(request: pytest.FixtureRequest) -> Iterator[RunningSim]:
    plugin, options = SIMS[request.param]
    with plugin.spawn(web=True, web_port=0, **options) as running:
        running.name = request.param
        yield running


def ask(sim: RunningSim, path: str, request: Any = None, **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(sim.host, sim.ports["web"], timeout=LONG)
    with closing(connection):
        body = None if request is None else json.dumps(request)
        headers = {"Content-Type": "application/json", **headers}
        connection.request("GET" if body is None else "POST", path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()


def no_constant(name: str) -> None:
    pytest.fail(f"{name} is no JSON")


def scene(sim: RunningSim) -> dict[str, Any]:
    status, body = ask(sim, "/scene.json")
    assert status == 200
    found: dict[str, Any] = json.loads(body, parse_constant=no_constant)
    return found


def live(sim: RunningSim) -> dict[str, Any]:
    connection = http.client.HTTPConnection(sim.host, sim.ports["web"], timeout=LONG)
    with closing(connection):
        connection.request("GET", "/events")
        with connection.getresponse() as answer:
            line = answer.readline()
    found: dict[str, Any] = json.loads(line.removeprefix(b"data: "), parse_constant=no_constant)
    return found


def gauges(found: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    return {group["title"]: group["gauges"] for group in found["gauges"]}


def test_it_is_told_where_the_page_is(sim: RunningSim) -> None:
    address = f"page: http://{sim.host}:{sim.ports['web']}/#{token()}"
    assert address in sim.hints
    assert ask(sim, "/")[0] == 200


def test_a_driver_on_it_tells_that_address_too(
    sim: RunningSim, capsys: pytest.CaptureFixture[str]
) -> None:
    _tell_page(None)
    assert capsys.readouterr().err == ""
    _tell_page(sim)
    told = capsys.readouterr().err
    assert told == f"page: http://{sim.host}:{sim.ports['web']}/#{token()}\n"


def test_what_the_simulator_refuses_is_no_hang(sim: RunningSim) -> None:
    found = pictures((sim.host, sim.ports["control"]), ("scene", "rain"), 0.1, lambda _: False)
    with pytest.raises(ControlError, match="unknown request 'rain'"):
        next(found)


def test_the_scene_says_what_it_is(sim: RunningSim) -> None:
    found = scene(sim)
    assert set(found) == {"title", "detail", "host", "buttons", "notes", "chain"}
    assert found["title"]
    assert found["host"] == sim.host
    assert (found["chain"] is not None) is (sim.name == "ur")
    assert len({each["text"] for each in found["buttons"]}) == len(found["buttons"]) >= 5


def test_what_changes_has_gauges_rows_and_faults(sim: RunningSim) -> None:
    found = live(sim)
    assert found["faults"] == []
    assert "Simulator" in found["sections"]
    names = [name for rows in found["sections"].values() for name, _, _ in rows]
    assert set(scene(sim)["notes"]) <= set(names)
    for rows in found["sections"].values():
        for name, text, level in rows:
            assert name
            assert isinstance(text, str)
            assert level in ("", "good", "fair", "bad")
    for group in found["gauges"]:
        assert group["gauges"]
        for each in group["gauges"]:
            assert isinstance(each["value"], float | int), each
            assert each["low"] is None or each["low"] < each["high"]


def test_every_button_lets_its_fault_begin_and_they_all_end(sim: RunningSim) -> None:
    for each in scene(sim)["buttons"]:
        request = {"kind": each["kind"], "parameters": each["parameters"]}
        assert ask(sim, "/inject", request, **WITH_TOKEN) == (200, b"{}"), each
    faults = sim.control.status()["faults"]
    assert len(faults) >= 4
    assert ask(sim, "/clear", {}, **WITH_TOKEN) == (200, b"{}")
    assert sim.control.status()["faults"] == []


def test_without_the_token_nothing_begins(sim: RunningSim) -> None:
    each = scene(sim)["buttons"][0]
    request = {"kind": each["kind"], "parameters": each["parameters"]}
    status, reason = ask(sim, "/inject", request)
    assert status == 401
    assert b"token" in reason
    assert sim.control.status()["faults"] == []


def test_an_unknown_fault_is_refused_with_the_reason(sim: RunningSim) -> None:
    status, reason = ask(sim, "/inject", {"kind": "rain", "parameters": {}}, **WITH_TOKEN)
    assert status == 400
    assert b"unknown kind of fault 'rain'" in reason


@pytest.mark.parametrize("sim", ["dynamixel"], indirect=True)
def test_servos_have_their_limits_and_states(sim: RunningSim) -> None:
    found = gauges(live(sim))
    assert list(found) == ["Bus 1", "Bus 2"]
    first, second = found["Bus 1"]
    assert (first["name"], second["name"]) == ("1: xl430-w250", "2: ax-12a")
    assert (first["low"], first["high"]) == pytest.approx((-180, 180), abs=0.2)
    assert (second["low"], second["high"]) == pytest.approx((-150, 150), abs=0.5)
    assert first["state"][0].startswith("torque off")
    sim.control.call("place", id=1, angle=1.0)
    assert gauges(live(sim))["Bus 1"][0]["value"] == pytest.approx(57.3, abs=0.1)


@pytest.mark.parametrize("sim", ["netft"], indirect=True)
def test_the_wrench_is_between_the_rated_loads(sim: RunningSim) -> None:
    found = gauges(live(sim))
    assert [each["value"] for each in found["Force"]] == pytest.approx([0, 0, -20], abs=0.1)
    assert [each["value"] for each in found["Torque"]] == pytest.approx([0, 2, 0], abs=0.1)
    assert all(-each["low"] == each["high"] > 1 for each in found["Force"] + found["Torque"])


@pytest.mark.parametrize("sim", ["canopen"], indirect=True)
def test_each_axis_of_a_drive_has_its_gauge(sim: RunningSim) -> None:
    found = gauges(live(sim))
    names = [each["name"] for each in found["Motors"]]
    assert names == ["node 1.0", "node 1.1", "node 2.0", "node 2.1"]
    sim.control.inject("fault", node=2)
    states = [each["state"] for each in gauges(live(sim))["Motors"]]
    assert "fault, no mode, error 1000h" in states[2][0]
    assert [level for _, level in states] == ["", "", "bad", ""]
