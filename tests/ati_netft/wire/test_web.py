"""The sensor's web server over sockets: slow, long, cut off, and not HTTP."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest

from crtk_driver_ati_netft.calibration import LONGEST_PAGE
from crtk_driver_ati_netft.web import WebPages
from crtk_drivers.errors import ConnectionFailed, ProtocolError
from rigs.waiting import LONG

PAGE = (
    b"<netft><cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt><scfgfu>N</scfgfu><scfgtu>Nm</scfgtu>"
    b"<prodname>ATI Net F/T</prodname></netft>"
)
OK = b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\n"

Serve = Callable[[socket.socket, threading.Event], None]


@contextmanager
def server(serve: Serve, timeout: float = LONG) -> Iterator[tuple[WebPages, list[bytes]]]:
    """Answer each connection by `serve`; the requests are collected."""
    requests: list[bytes] = []
    ended = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.05)

    def run() -> None:
        while not ended.is_set():
            try:
                peer, _ = listener.accept()
            except TimeoutError:
                continue
            with peer:
                peer.settimeout(LONG)
                with suppress(ConnectionError):  # the client may have had enough
                    data = b""
                    while b"\r\n\r\n" not in data:
                        if not (piece := peer.recv(4096)):
                            raise ConnectionResetError
                        data += piece
                    requests.append(data)
                    serve(peer, ended)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield WebPages("127.0.0.1", listener.getsockname()[1], timeout=timeout), requests
    finally:
        ended.set()
        thread.join()
        listener.close()


def sends(*pieces: bytes, pause: float = 0.0) -> Serve:
    def serve(peer: socket.socket, ended: threading.Event) -> None:
        for piece in pieces:
            peer.sendall(piece)
            if pause and ended.wait(pause):
                return

    return serve


def with_length(body: bytes) -> bytes:
    return OK + b"Content-Length: %d\r\n\r\n" % len(body) + body


@pytest.mark.parametrize(
    "answer",
    [
        sends(with_length(PAGE)),
        sends(OK + b"\r\n" + PAGE),
        sends(*(with_length(PAGE)[i : i + 1] for i in range(len(with_length(PAGE))))),
        sends(b"HTTP/1.0 200\r\ncontent-length:%d\r\n\r\n" % len(PAGE) + PAGE),
    ],
    ids=["with length", "until the end", "byte by byte", "other spellings"],
)
def test_a_page_is_read(answer) -> None:
    with server(answer) as (web, requests):
        assert web.read().product == "ATI Net F/T"
    assert requests[0].startswith(b"GET /netftapi2.xml HTTP/1.0\r\nHost: 127.0.0.1\r\n")


def test_a_connection_that_stays_open_does_not_delay_what_is_complete() -> None:
    def serve(peer: socket.socket, ended: threading.Event) -> None:
        peer.sendall(with_length(PAGE))
        ended.wait(5.0)

    with server(serve) as (web, _):
        assert web.read().scale.counts_per_force == 1e6


def test_settings_go_out_in_one_request_and_in_order() -> None:
    with server(sends(with_length(b"<html>ok</html>"))) as (web, requests):
        web.write("setting.cgi", [(f"setbias{i}", 0) for i in range(6)])
        web.write("config.cgi", {"cfgid": 1, "cfgnam": "A & B", "cfgtfx0": -1.5})
    assert requests[0].split(b" ")[1] == (
        b"/setting.cgi?setbias0=0&setbias1=0&setbias2=0&setbias3=0&setbias4=0&setbias5=0"
    )
    assert requests[1].split(b" ")[1] == b"/config.cgi?cfgid=1&cfgnam=A+%26+B&cfgtfx0=-1.5"


@pytest.mark.parametrize(
    "answer",
    [
        sends(b"H", b"TTP/1.1 2", b"00 OK\r\n", *[b"x"] * 1000, pause=0.1),
        sends(OK, *[b"X-Header: nonsense\r\n"] * 1000, pause=0.1),
        sends(OK + b"Content-Length: 1000\r\n\r\n" + PAGE, pause=100.0),
        sends(OK + b"Content-Length: 1000\r\n\r\n" + PAGE),
        sends(b"", pause=100.0),
    ],
    ids=["trickles", "trickles headers", "stops", "is cut off", "says nothing"],
)
def test_a_server_that_takes_its_time_does_not_get_more_than_the_deadline(answer) -> None:
    with server(answer, timeout=0.4) as (web, _), pytest.raises(ConnectionFailed) as caught:
        web.read()
    assert caught.value.where.startswith("http://127.0.0.1:")
    assert caught.value.remedy


def test_a_deadline_of_the_caller_counts_as_well() -> None:
    with (
        server(sends(b"", pause=100.0)) as (web, _),
        pytest.raises(ConnectionFailed, match="in time"),
    ):
        web.read(time.monotonic() + 0.05)
    with server(sends(b"")) as (web, requests), pytest.raises(ConnectionFailed, match="in time"):
        web.read(time.monotonic() - 1.0)
    assert requests == []


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (sends(with_length(b" " * LONGEST_PAGE + PAGE)), "longer than"),
        (sends(OK + b"\r\n", *[b" " * 65536] * 100), "longer than"),
        (sends(OK, *[b"a" * 65536] * 100), "not HTTP"),
        (sends(b"SSH-2.0-OpenSSH\r\n"), "not HTTP"),
        (sends(b""), "not HTTP"),
        (sends(b"HTTP/1.1 404 Not Found\r\n\r\n"), "404 Not Found"),
        (sends(b"HTTP/1.1 500 Sorry\r\nContent-Length: 0\r\n\r\n"), "500 Sorry"),
        (sends(with_length(b"<html/>")), "<html>"),
    ],
    ids=["long", "endless", "endless head", "ssh", "nothing", "404", "500", "another page"],
)
def test_what_is_no_page_is_refused(answer, message) -> None:
    with server(answer) as (web, _), pytest.raises(ProtocolError) as caught:
        web.read()
    assert message in caught.value.message


def test_an_answer_to_settings_has_an_end_as_well() -> None:
    endless = sends(OK + b"\r\n", *[b" " * 65536] * 100)
    with server(endless) as (web, _), pytest.raises(ProtocolError, match="longer than"):
        web.write("setting.cgi", {"setuserfilter": 0})


def test_no_server_is_no_connection() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(ConnectionFailed, match="refused"):
        WebPages("127.0.0.1", port).read()
