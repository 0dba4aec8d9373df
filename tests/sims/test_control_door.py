"""The control socket of every simulator: who may open it, and what a page in a browser gets."""

from __future__ import annotations

import json
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from crtk_sim_backends import control
from crtk_sim_backends.can import SIM as CAN
from crtk_sim_backends.canopen import SIM as CANOPEN
from crtk_sim_backends.control import ControlClient, ControlError
from crtk_sim_backends.dynamixel import SIM as DYNAMIXEL
from crtk_sim_backends.ndi import SIM as NDI
from crtk_sim_backends.netft import SIM as NETFT
from crtk_sim_backends.process import RunningSim
from crtk_sim_backends.ur import SIM as UR
from rigs.waiting import LONG

SIMS: dict[str, tuple[Any, dict[str, Any], str]] = {
    "can": (CAN, {}, "bus_off"),
    "canopen": (CANOPEN, {}, "bus_off"),
    "dynamixel": (DYNAMIXEL, {}, "silence"),
    "ndi": (NDI, {}, "frozen"),
    "netft": (NETFT, {"rdt_port": 0, "tcp_port": 0, "http_port": 0}, "frozen"),
    "ur": (UR, {}, "protective_stop"),
}
STATUS = b'{"do": "status"}\n'


@pytest.fixture(scope="module", params=SIMS)
def sim(request: pytest.FixtureRequest) -> Iterator[RunningSim]:
    plugin, options, _ = SIMS[request.param]
    with plugin.spawn(**options) as running:
        yield running


def hello(token: str | None = None) -> bytes:
    return json.dumps({"token": control.token() if token is None else token}).encode() + b"\n"


def answers(sim: RunningSim, *pieces: bytes, done: bool = False) -> list[dict[str, Any]]:
    """Send to the control socket, and return what it answers until it closes; `done`: as we do."""
    with socket.create_connection((sim.host, sim.ports["control"]), LONG) as peer:
        data = b""
        try:
            for piece in pieces:
                peer.sendall(piece)
            if done:
                peer.shutdown(socket.SHUT_WR)
            while piece := peer.recv(65536):
                data += piece
        except ConnectionError:
            pass  # it was closed before all was sent
    return [json.loads(line) for line in data.splitlines()]


def test_a_page_in_a_browser_gets_no_word_and_does_nothing(sim: RunningSim) -> None:
    body = STATUS + hello("guess") + STATUS
    for head in (
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://evil.example\r\n"
        b"Content-Type: text/plain\r\nContent-Length: %d\r\n\r\n" % len(body),
        b"GET /?{} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\n",
    ):
        assert answers(sim, head, body) == []
        assert answers(sim, head + body) == []


@pytest.mark.parametrize(
    "first",
    [
        STATUS,
        hello("0" * 32),
        hello(""),
        b"{}\n",
        b'{"token": null}\n',
        b'{"token": ["a"]}\n',
        '{"token": "ä"}\n'.encode(),
    ],
)
def test_without_the_token_nothing_is_done_and_it_is_told_why(
    sim: RunningSim, first: bytes
) -> None:
    told = answers(sim, first)
    assert len(told) == 1
    assert not told[0]["ok"]
    assert "token" in told[0]["error"]


@pytest.mark.parametrize("first", [b"\n", b"[]\n", b"1\n", b"\xff\n", b"[" * 2000 + b"\n"])
def test_a_first_line_that_is_none_of_ours_ends_it(sim: RunningSim, first: bytes) -> None:
    assert answers(sim, first, hello(), STATUS) == []


def test_a_first_line_that_does_not_end_is_not_kept(sim: RunningSim) -> None:
    assert answers(sim, b'{"token": "' + b"x" * 8192, b'"}\n', STATUS) == []


def test_with_the_token_in_any_pieces_it_serves(sim: RunningSim) -> None:
    line = hello() + STATUS
    for pieces in ([line], [line[i : i + 1] for i in range(len(line))]):
        assert [answer["ok"] for answer in answers(sim, *pieces, done=True)] == [True, True]


def test_a_client_with_another_token_is_told(sim: RunningSim) -> None:
    with (
        ControlClient(sim.host, sim.ports["control"], secret="other") as other,
        pytest.raises(ControlError, match="token"),
    ):
        other.status()
    assert sim.control.status()


def test_the_token_is_in_a_file_that_nobody_else_may_read() -> None:
    path = control.token_file()
    assert path.read_text().strip() == control.token()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) & 0o077 == 0
    assert len(control.token()) >= 32


def test_the_environment_gives_another(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CRTK_SIM_TOKEN", "a token that two machines share")
    plugin, options, _ = SIMS["netft"]
    with plugin.spawn(**options) as running:
        assert running.control.status()
        assert answers(running, hello("x"))[0]["ok"] is False
        monkeypatch.delenv("CRTK_SIM_TOKEN")
        with (
            ControlClient(running.host, running.ports["control"]) as other,
            pytest.raises(ControlError, match="token"),
        ):
            other.status()


def test_a_place_that_others_can_write_to_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    place = tmp_path / f"crtk-sim-{os.getuid()}"
    place.mkdir(mode=0o777)
    place.chmod(0o777)
    monkeypatch.delenv("CRTK_SIM_TOKEN", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(ControlError, match="others"):
        control.token()


def test_two_that_begin_at_once_have_one_token(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("CRTK_SIM_TOKEN", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    tmp_path.chmod(0o700)
    found = {control.token() for _ in range(3)}
    assert len(found) == 1
    assert [path.name for path in control.token_file().parent.iterdir()] == ["token"]
