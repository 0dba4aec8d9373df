"""The server of the page of all devices: who may look, who may command, and what none does to others."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import signal
import socket
import struct
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed

from crtk_sim_backends.page.devices import PAGE
from crtk_sim_backends.page.looking import LARGEST
from crtk_sim_backends.page.server import ASKING, WATCHERS
from crtk_sim_backends.page.source import PERIOD
from rigs.view_page import LONG, ViewPage
from rigs.waiting import eventually

SECRET = "the-token-of-this-test"


class Scripted:
    """What is shown, and how often it was asked for."""

    def __init__(self) -> None:
        self.secret: str | None = SECRET
        self.looks = 0
        self.commands: list[tuple[int, dict[str, Any]]] = []
        self.watched: list[tuple[str, str]] = []
        self.has_ended = threading.Event()
        self.weight = ""

    def scene(self) -> Mapping[str, Any]:
        return {"title": "scripted"}

    def live(self) -> Mapping[str, Any]:
        self.looks += 1
        return {"number": self.looks, "weight": self.weight}

    def watch(self, namespace: str, name: str) -> bool:
        self.watched.append((namespace, name))
        return True

    def command(self, browser: int, arguments: Mapping[str, Any]) -> str:
        self.commands.append((browser, dict(arguments)))
        return "not today" if arguments.get("do") == "refused" else ""

    def ended(self) -> None:
        self.has_ended.set()

    def told(self, what: str) -> list[int]:
        """Return the browsers that asked for something."""
        return [browser for browser, given in tuple(self.commands) if given.get("do") == what]


@pytest.fixture
def shown() -> Scripted:
    return Scripted()


@pytest.fixture
def page(shown: Scripted) -> Iterator[Any]:
    served = PAGE.serve(shown, 0)
    yield served
    served.stop()


def with_token(page: Any) -> str:
    return f"{page.address}#{SECRET}"


def host_of(page: Any) -> str:
    return str(page.address.split("/")[2])


def test_whoever_is_on_this_machine_may_look(page: Any, shown: Scripted) -> None:
    with ViewPage(page.address) as browser:
        assert browser.scene() == {"title": "scripted"}
        assert browser.live()["number"] == 1
        browser.send({"watch": ["/arm", "measured_cv"]})
        browser.live()
    assert shown.watched == [("/arm", "measured_cv")]


def test_the_files_of_the_page_are_all_here(page: Any) -> None:
    connection = http.client.HTTPConnection(host_of(page), timeout=LONG)
    with contextlib.closing(connection):
        connection.request("GET", "/")
        text = connection.getresponse().read().decode()
    assert "http://" not in text.replace("http://www.w3.org", "")
    assert "https://" not in text
    assert '<script type="module" src="/devices.js">' in text


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": ""}, 403),
        ({"Origin": None}, 403),
        ({"Host": "evil.example"}, 421),
        ({"Host": "evil.example", "Origin": "http://evil.example"}, 421),
    ],
)
def test_a_page_of_another_site_can_neither_look_nor_command(
    page: Any, shown: Scripted, headers: dict[str, str | None], status: int
) -> None:
    netloc = host_of(page)
    lines = {
        "Host": netloc,
        "Origin": f"http://{netloc}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version": "13",
    } | headers
    connection = http.client.HTTPConnection(netloc, timeout=LONG)
    with contextlib.closing(connection):
        connection.putrequest("GET", "/socket", skip_host=True)
        for name, value in lines.items():
            if value is not None:
                connection.putheader(name, value)
        connection.endheaders()
        assert connection.getresponse().status == status
    assert shown.looks == 0
    assert shown.commands == []


def test_the_handshake_is_known_by_its_answer(page: Any) -> None:
    """RFC 6455, section 1.3: the key of its example, and the answer to it."""
    netloc = host_of(page)
    connection = http.client.HTTPConnection(netloc, timeout=LONG)
    with contextlib.closing(connection):
        connection.request(
            "GET",
            "/socket",
            headers={
                "Origin": f"http://{netloc}",
                "Upgrade": "websocket",
                "Connection": "Upgrade",
                "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
                "Sec-WebSocket-Version": "13",
            },
        )
        answer = connection.getresponse()
        assert answer.status == 101
        assert answer.getheader("Sec-WebSocket-Accept") == "s3pPLMBiTxaQ9kYGzzhZRbK+xOo="


@pytest.mark.parametrize("token", ["", "wrong", SECRET[:-1], SECRET + "x", "\ud800", 7, None])
def test_without_the_token_nothing_is_commanded(page: Any, shown: Scripted, token: object) -> None:
    with ViewPage(page.address) as browser:
        assert browser.ask({"token": token}) == {"control": False}
        assert "token" in browser.command(do="enable", device="/arm")
    assert shown.commands == []


def test_with_the_token_it_is_commanded_and_told_what_was_refused(
    page: Any, shown: Scripted
) -> None:
    with ViewPage(with_token(page)) as browser:
        assert browser.command(do="hold") == ""
        assert browser.command(do="refused") == "not today"
    eventually(lambda: shown.told("gone"), "it is told that the browser has gone")
    assert shown.told("gone") == shown.told("hold")


def test_without_control_no_token_opens_it(shown: Scripted) -> None:
    shown.secret = None
    served = PAGE.serve(shown, 0)
    try:
        with ViewPage(served.address) as browser:
            for token in ("", "None", "null", None):
                assert browser.ask({"token": token}) == {"control": False}
            assert browser.command(do="hold") != ""
        assert shown.commands == []
    finally:
        served.stop()


@pytest.mark.parametrize(
    "message",
    [
        "",
        "[]",
        "7",
        "{}",
        '{"look": true, "scene": true}',
        '{"fire": 1}',
        '{"command": 7}',
        "[" * 3000,
    ],
)
def test_what_is_no_message_ends_the_connection_of_the_one_that_sent_it(
    page: Any, shown: Scripted, message: str
) -> None:
    with ViewPage(with_token(page)) as browser, ViewPage(page.address) as other:
        browser.socket.send(message)
        with pytest.raises(ConnectionClosed):
            browser.socket.recv(timeout=LONG)
        assert other.live()["number"] >= 1
    assert [given["do"] for _, given in shown.commands] in ([], ["gone"])


def test_a_message_that_is_too_long_or_no_text_is_not_read(page: Any) -> None:
    for message in ("x" * (LARGEST + 1), b'{"look": true}'):
        with ViewPage(page.address) as browser:
            browser.socket.send(message)
            with pytest.raises(ConnectionClosed):
                browser.socket.recv(timeout=LONG)


def test_nothing_is_made_while_nobody_asks(page: Any, shown: Scripted) -> None:
    with ViewPage(page.address) as hidden, ViewPage(page.address) as looking:
        hidden.live()
        before = shown.looks
        for _ in range(5):
            looking.live()
        made = shown.looks
        assert before < made <= before + 5
        for _ in range(5):
            looking.scene()
        assert shown.looks == made


def test_pictures_come_at_most_thirty_times_a_second_however_many_look(
    page: Any, shown: Scripted
) -> None:
    with contextlib.ExitStack() as opened:
        browsers = [opened.enter_context(ViewPage(page.address)) for _ in range(5)]
        began, before = time.monotonic(), shown.looks
        for _ in range(10):
            for browser in browsers:
                browser.send({"look": True})
            for browser in browsers:
                browser.next()
        assert shown.looks - before <= (time.monotonic() - began) / (0.9 * PERIOD) + 1


def test_a_browser_that_stops_reading_holds_nobody(page: Any, shown: Scripted) -> None:
    shown.weight = "x" * 2_000_000
    with ViewPage(page.address) as stuck, ViewPage(page.address) as other:
        stuck.socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for _ in range(20):
            stuck.send({"look": True})  # and reads none
        for _ in range(5):
            assert other.live()["weight"] == shown.weight


def test_only_so_many_look_but_whoever_has_the_token_always_may(page: Any) -> None:
    with contextlib.ExitStack() as opened:
        for _ in range(WATCHERS):
            opened.enter_context(ViewPage(page.address)).live()
        late = opened.enter_context(ViewPage(page.address))
        with pytest.raises(ConnectionClosed, match="as many browsers"):
            late.live()
        pilot = opened.enter_context(ViewPage(with_token(page)))
        assert pilot.live()["number"] >= 1

    def has_place() -> bool:
        with ViewPage(page.address) as browser, contextlib.suppress(ConnectionClosed):
            return bool(browser.live())
        return False

    eventually(has_place, "places become free again")


def flood(page: Any, count: int) -> list[socket.socket]:
    """Open connections that ask for nothing."""
    host, port = host_of(page).split(":")
    return [socket.create_connection((host, int(port)), LONG) for _ in range(count)]


@pytest.mark.parametrize("count", [3 * ASKING, pytest.param(10_000, marks=pytest.mark.slow)])
def test_connections_that_ask_nothing_make_place(page: Any, shown: Scripted, count: int) -> None:
    """Ten thousand of them, hundreds at a time: whoever commands goes on, and a new browser is let in."""
    with ViewPage(with_token(page)) as pilot:
        left = count
        while left > 0:
            opened = flood(page, min(left, 400))
            left -= len(opened)
            assert pilot.command(do="hold") == ""
            with ViewPage(page.address) as late:
                assert late.live()["number"] >= 1
            for each in opened:
                each.close()
        assert pilot.live()["number"] >= 1
    threads = 2 * ASKING + 10
    eventually(lambda: len(os.listdir(f"/proc/{page.pid}/task")) < threads, "they have ended")


@pytest.mark.slow
def test_what_takes_some_seconds_to_be_done_ends_no_connection(page: Any, shown: Scripted) -> None:
    """As on a busy machine; a hold that is asked for then is the last to be lost."""
    carry_out = shown.command

    def late(browser: int, arguments: Mapping[str, Any]) -> str:
        time.sleep(2.0)
        return carry_out(browser, arguments)

    shown.command = late  # type: ignore[method-assign]
    with ViewPage(with_token(page)) as browser:
        assert browser.command(do="hold") == ""
        assert browser.live()["number"] >= 1


def test_the_end_of_the_server_is_told(page: Any, shown: Scripted) -> None:
    with ViewPage(with_token(page)) as browser:
        browser.command(do="hold")
        os.kill(page.pid, signal.SIGKILL)
        assert shown.has_ended.wait(LONG)
        with pytest.raises(ConnectionClosed):
            browser.socket.recv(timeout=LONG)


def test_a_connection_that_is_cut_off_is_told_as_gone(page: Any, shown: Scripted) -> None:
    browser = ViewPage(with_token(page))
    browser.command(do="jog")
    raw = browser.socket.socket
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    raw.shutdown(socket.SHUT_RDWR)
    eventually(lambda: shown.told("gone"), "it is told that the browser has gone")
    assert shown.told("gone") == shown.told("jog")


def test_a_frame_in_pieces_is_refused(page: Any) -> None:
    """RFC 6455, section 5.4: browsers send none of that size in pieces."""
    browser = ViewPage(page.address)
    with pytest.raises(ConnectionClosed, match="one piece"), browser:  # noqa: PT012 - either may see it
        with browser.socket.send_context():  # what it sends after that might meet the end
            browser.socket.protocol.send_text(b'{"lo', fin=False)
        browser.socket.recv(timeout=LONG)


def test_what_is_shown_may_hold_what_json_cannot(page: Any, shown: Scripted) -> None:
    shown.weight = float("nan")  # type: ignore[assignment]
    with ViewPage(page.address) as browser:
        assert browser.live()["weight"] is None
    assert json.dumps(shown.looks)
