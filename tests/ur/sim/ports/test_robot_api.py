"""The Robot API of PolyScope X, over HTTP, as UR's client library uses it."""

from __future__ import annotations

import http.client
import io
import json
import zipfile

import pytest

from crtk_sim_backends.ur import SIM, ConfigError
from rigs.ur_clients import TcpClient
from rigs.waiting import eventually

BASE = "/universal-robots/robot-api"


class Api:
    """One kept-open connection."""

    def __init__(self, sim):
        self.connection = http.client.HTTPConnection(sim.host, sim.ports["robot_api"], 20.0)

    def ask(self, method, path, **body):
        self.connection.request(
            method,
            BASE + path,
            json.dumps(body) if body else None,
            {"Content-Type": "application/json"},
        )
        response = self.connection.getresponse()
        return response.status, json.loads(response.read())

    def get(self, path):
        status, content = self.ask("GET", path)
        assert status == 200
        return content

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.connection.close()


def spawn(version="10.14.0", **options):
    return SIM.spawn(version=version, robot_api=True, robot_api_port=0, **options)


@pytest.fixture(scope="module")
def sim():
    with spawn() as running:
        yield running


@pytest.fixture
def api(sim):
    with Api(sim) as opened:
        yield opened


@pytest.mark.parametrize(
    ("path", "content"),
    [
        ("/robotstate/v1/robotmode", {"mode": "RUNNING"}),
        ("/robotstate/v1/safetymode", {"mode": "NORMAL"}),
        ("/program/v1/state", {"state": "STOPPED"}),
        ("/program/v1/loaded", {"name": "Default program"}),
        ("/system/v1/controlmode", {"mode": "REMOTE"}),
        ("/system/v1/operationalmode", {"mode": "AUTOMATIC"}),
        ("/system/v1/information", {"robotType": "UR5e", "serialNumber": "20235500001"}),
        ("/versions/v1", {"marketingVersion": "10.14.0", "baselineVersion": "10.14.0.0"}),
    ],
)
def test_questions(api, path, content):
    assert api.get(path) == content


@pytest.mark.parametrize(
    ("software", "version"), [("10.11", "3.0.0"), ("10.12", "3.1.4"), ("10.15", "5.0.107")]
)
def test_the_interface_has_a_version_of_its_own(software, version):
    with spawn(software) as own, Api(own) as api:
        assert api.get("/openapi.json")["info"]["version"] == version


def test_commands_are_answered_when_they_are_done(api):
    for action, mode in (
        ("POWER_OFF", "POWER_OFF"),
        ("POWER_ON", "IDLE"),
        ("BRAKE_RELEASE", "RUNNING"),
    ):
        assert api.ask("PUT", "/robotstate/v1/state", action=action)[0] == 200
        assert api.get("/robotstate/v1/robotmode") == {"mode": mode}


def test_a_program_is_loaded_played_paused_resumed_and_stopped(api):
    assert api.ask("PUT", "/program/v1/loaded", name="simulation")[0] == 200
    assert api.get("/program/v1/loaded") == {"name": "simulation"}
    programs = api.get("/programs/v1/")["programs"]
    assert "simulation" in [program["name"] for program in programs]
    # UR's client library of before September 2026 takes these for texts.
    assert all(isinstance(p[key], str) for p in programs for key in ("description", "programState"))
    for action, state in (
        ("play", "PLAYING"),
        ("pause", "PAUSED"),
        ("resume", "PLAYING"),
        ("stop", "STOPPED"),
    ):
        assert api.ask("PUT", "/program/v1/state", action=action)[0] == 200
        assert api.get("/program/v1/state") == {"state": state}
    status, content = api.ask("PUT", "/program/v1/state", action="pause")
    assert (status, "STOPPED" in content["message"]) == (409, True)


PROGRAM = {
    "application": {"urscript": {"script": "def nap(s):\n  sleep(s)\nend"}},
    "program": {
        "programInformation": {"name": "test upload", "programState": "FINAL"},
        "urscript": {"script": '$ 1 "ur-program"\n$ 2 "ur-wait"\nnap(23)'},
    },
}
"""What of a .urpx counts: names, and the scripts that PolyScope X has made of its trees."""


def form(content):
    """Body and content type as UR's client library sends a file."""
    part = 'Content-Disposition: form-data; name="file"; filename="filename"'
    body = f"--edge\r\n{part}\r\nContent-Type: text/plain\r\n\r\n{content}\n\r\n--edge--\r\n"
    return body, {"Content-Type": "multipart/form-data; boundary=edge"}


def send(api, method, content):
    api.connection.request(method, f"{BASE}/programs/v1/", *form(content))
    response = api.connection.getresponse()
    return response.status, json.loads(response.read())


def test_a_program_is_uploaded_updated_downloaded_and_played():
    with spawn("10.12") as own, Api(own) as api:
        uploaded = (200, {"programName": "test upload"})
        assert send(api, "PUT", json.dumps(PROGRAM))[0] == 404
        assert send(api, "POST", json.dumps(PROGRAM)) == uploaded
        assert send(api, "POST", json.dumps(PROGRAM))[0] == 400  # exists
        assert send(api, "PUT", json.dumps(PROGRAM)) == uploaded
        assert api.get("/programs/v1/test%20upload") == PROGRAM
        assert api.ask("GET", "/programs/v1/missing")[0] == 404
        assert "test upload" in [p["name"] for p in api.get("/programs/v1")["programs"]]
        assert api.ask("PUT", "/program/v1/loaded", name="test upload")[0] == 200
        assert api.ask("PUT", "/program/v1/state", action="play")[0] == 200
        assert api.get("/program/v1/state") == {"state": "PLAYING"}


@pytest.mark.parametrize("content", ["", "[]", "{", '{"program": {"urscript": {"script": ""}}}'])
def test_what_is_no_program_is_not_taken(api, content):
    status, answer = send(api, "POST", content)
    assert status == 400
    assert "the file is no" in answer["message"]
    assert api.ask("POST", "/programs/v1", file="none")[0] == 400


def test_support_files_are_made_and_fetched(api):
    assert api.ask("POST", "/supportfiles/v1")[0] == 200
    api.connection.request("GET", f"{BASE}/supportfiles/v1")
    archive = api.connection.getresponse().read()
    assert zipfile.ZipFile(io.BytesIO(archive)).namelist() == []


def test_unlocking_a_protective_stop_waits_until_it_may_be():
    with spawn(lock_seconds=1.0) as sim, Api(sim) as api:
        began = sim.control.status()["time"]
        sim.control.inject("protective_stop")
        eventually(lambda: api.get("/robotstate/v1/safetymode")["mode"] == "PROTECTIVE_STOP")
        assert api.ask("PUT", "/robotstate/v1/state", action="UNLOCK_PROTECTIVE_STOP")[0] == 200
        assert api.get("/robotstate/v1/safetymode") == {"mode": "NORMAL"}
        assert sim.control.status()["time"] - began > 1.0


@pytest.mark.parametrize(
    ("method", "path", "body", "status"),
    [
        ("GET", "/nothing", {}, 404),
        ("PUT", "/versions/v1", {"a": "b"}, 405),
        ("PUT", "/robotstate/v1/state", {"action": "DANCE"}, 400),
        ("PUT", "/robotstate/v1/state", {"action": 5}, 400),
        ("PUT", "/robotstate/v1/state", {}, 400),
        ("PUT", "/program/v1/loaded", {"name": "missing"}, 404),
        ("POST", "/popup/v1", {"title": "t", "message": "m"}, 200),
        ("DELETE", "/popup/v1", {}, 200),
        ("POST", "/system/v1/log", {"message": "m"}, 200),
    ],
)
def test_refusals_have_a_status_and_leave_the_connection_open(api, method, path, body, status):
    assert api.ask(method, path, **body)[0] == status
    assert api.get("/robotstate/v1/robotmode") == {"mode": "RUNNING"}


def test_local_control_refuses_commands_and_answers_questions():
    with spawn(remote=False) as own, Api(own) as api:
        assert api.get("/system/v1/controlmode") == {"mode": "LOCAL"}
        assert api.ask("PUT", "/robotstate/v1/state", action="POWER_OFF")[0] == 403
        assert api.ask("PUT", "/program/v1/loaded", name="simulation")[0] == 403


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (b"nonsense\r\n\r\n", b"400"),
        (b"PUT /a HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n", b"411"),
        (b"PUT /a HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n", b"413"),
        (b"PUT /a HTTP/1.1\r\nContent-Length: -1\r\n\r\n", b"400"),
        (b"x" * 20_000, b"413"),
    ],
)
def test_what_is_no_request_ends_the_connection(sim, request_, status):
    with TcpClient(sim.host, sim.ports["robot_api"]) as client:
        client.send(request_)
        assert client.read(12) == b"HTTP/1.1 " + status
        assert client.closed_by_peer()


def test_requests_may_arrive_byte_by_byte_and_two_at_once(sim):
    request = f"GET {BASE}/robotstate/v1/robotmode HTTP/1.1\r\nHost: robot\r\n\r\n".encode()
    with TcpClient(sim.host, sim.ports["robot_api"]) as client:
        for byte in request:
            client.send(bytes([byte]))
        client.send(request * 2)
        head = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 19\r\n\r\n"
        answers = (head + b'{"mode": "RUNNING"}') * 3
        assert client.read(len(answers)) == answers


def test_older_software_has_no_robot_api():
    with pytest.raises(ConfigError, match=r"10\.11"):
        SIM.spawn(version="10.9", robot_api=True)
