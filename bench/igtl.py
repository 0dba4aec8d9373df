"""The bridge of OpenIGTLink: messages a second, and latency, beside pyigtl; read by the C++ library too.

The C++ library is that of Debian (libopenigtlink-dev); where it is elsewhere, ``IGTL_PREFIX`` says where its
``include`` and ``lib`` are. Without it, and a compiler, that row is left out and said to be.
"""

from __future__ import annotations

import os
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import crtk_drivers
from bench.report import options, ratio, show, spread, time_calls
from crtk_drivers.commands import Command
from crtk_drivers.front.openigtlink import Bridge, Server
from crtk_drivers.front.openigtlink.bodies import Transform
from crtk_drivers.front.openigtlink.codec import HEADER, Damaged, Message, StreamDecoder, encode
from crtk_drivers.front.openigtlink.connection import Connection

HERE = Path(__file__).parent
MATRIX = np.array([(0, -1, 0, 46.0), (1, 0, 0, 19.5), (0, 0, 1, -46.0), (0, 0, 0, 1)], dtype=float)
TRANSFORM = Message("arm/measured_cp", Transform(MATRIX))
SIZE = len(encode(TRANSFORM))
NAMES = 8
"""Messages of so many names wait at once: newer ones of a name take the place of older ones."""


class Counting:
    """Who is behind a connection, and counts only."""

    def __init__(self) -> None:
        self.count = 0

    def take(self, connection: Connection, message: Message) -> None:
        """Count it."""
        self.count += 1

    def refuse(self, connection: Connection, damaged: Damaged) -> None:
        """Not called: nothing is damaged."""
        raise AssertionError(damaged)

    def left(self, connection: Connection) -> None:
        """Nothing moves."""

    def command(self, device: str) -> Command | None:
        """Return None: there are none."""
        return None


def pyigtl() -> Any:
    """Return the peer, None if it is not installed."""
    try:
        import pyigtl as peer
    except ImportError:
        return None
    return peer


@contextmanager
def our_connection() -> Iterator[tuple[Connection, Counting, socket.socket]]:
    """A connection of ours, and the socket at its other end."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        far = socket.create_connection(listening.getsockname())
        near, _ = listening.accept()
    served = Counting()
    connection = Connection(near, "bench", served)
    connection.start()
    try:
        yield connection, served, far
    finally:
        connection.end()
        far.close()
        connection.join(5.0)


def arriving(peer: socket.socket, seconds: float) -> float:
    """Return how many transforms a second arrive at a socket."""
    peer.settimeout(5.0)
    got, begin = 0, time.perf_counter()
    while (now := time.perf_counter()) < begin + seconds:
        got += len(peer.recv(1 << 16))
    return got / SIZE / (now - begin)


def feeding(connection: Connection, done: threading.Event) -> None:
    """Offer messages of `NAMES` names, again whenever they have been sent."""
    batch = [Message(f"arm{name}/measured_cp"[:20], Transform(MATRIX)) for name in range(NAMES)]
    while not done.is_set():
        if not connection.waiting:
            connection.offer(batch)
        time.sleep(0)


def sent_by_us(seconds: float) -> float:
    """Return how many messages a second one connection sends."""
    done = threading.Event()
    with our_connection() as (connection, _, far):
        feeder = threading.Thread(target=feeding, args=(connection, done))
        feeder.start()
        try:
            return arriving(far, seconds)
        finally:
            done.set()
            feeder.join()


def sent_by_pyigtl(peer: Any, seconds: float) -> float:
    """Return the same of pyigtl's server."""
    server = peer.OpenIGTLinkServer(port=0)
    far = socket.create_connection(("127.0.0.1", server.socket.getsockname()[1]))
    done = threading.Event()
    message = peer.TransformMessage(MATRIX, device_name="arm/measured_cp")

    def feed() -> None:
        while not done.is_set():
            if len(server.outgoing_messages) < NAMES:
                server.send_message(message, wait=False)
            else:
                time.sleep(0)

    feeder = threading.Thread(target=feed)
    feeder.start()
    try:
        return arriving(far, seconds)
    finally:
        done.set()
        feeder.join()
        far.close()
        server.stop()


def pushed(far: socket.socket, stop: threading.Event) -> None:
    """Send transforms as fast as they are taken."""
    data = encode(TRANSFORM) * 100
    while not stop.is_set():
        try:
            far.sendall(data)
        except OSError:
            return


def taken_by_us(seconds: float) -> float:
    """Return how many messages a second one connection reads."""
    stop = threading.Event()
    with our_connection() as (_, served, far):
        sender = threading.Thread(target=pushed, args=(far, stop))
        sender.start()
        time.sleep(seconds)
        rate = served.count / seconds
        stop.set()
        far.close()
        sender.join()
    return rate


def taken_by_pyigtl(peer: Any, seconds: float) -> float:
    """Return the same of pyigtl's server."""

    class Server(peer.OpenIGTLinkServer):  # type: ignore[misc]
        count = 0

        def _receive_message_from_socket(self, ssocket: socket.socket) -> Any:
            found = super()._receive_message_from_socket(ssocket)
            self.count += bool(found)
            return found

    server, stop = Server(port=0), threading.Event()
    far = socket.create_connection(("127.0.0.1", server.socket.getsockname()[1]))
    sender = threading.Thread(target=pushed, args=(far, stop))
    sender.start()
    time.sleep(seconds)
    rate = server.count / seconds
    stop.set()
    server.communication_thread_stop_requested = True
    far.close()
    sender.join()
    server.stop()
    return rate


def late(far: socket.socket, seconds: float) -> list[float]:
    """Return by how much transforms arrive after the stamps in them, in s."""
    far.settimeout(5.0)
    found, rest, end = [], b"", time.monotonic() + seconds
    while time.monotonic() < end:
        rest += far.recv(1 << 16)
        now = time.time()
        while len(rest) >= HEADER.size:
            _, kind, _, stamp, size, _ = HEADER.unpack_from(rest)
            if len(rest) < HEADER.size + size:
                break
            rest = rest[HEADER.size + size :]
            if kind.startswith(b"TRANSFORM"):
                found.append(now - stamp / 2**32)
    return found[len(found) // 10 :]  # what was known before it connected is older


def late_of_us(rate: float, seconds: float) -> list[float]:
    """Return the latency of a device at 500 Hz, from its sample to a peer's socket."""
    with (
        crtk_drivers.connect("loopback", rate=500.0) as arm,
        Bridge({"arm": arm}, rate=rate, only=["measured_cp"]) as bridge,
    ):
        server = Server(bridge, port=0)
        server.start()
        try:
            with socket.create_connection(("127.0.0.1", server.port)) as far:
                return late(far, seconds)
        finally:
            server.close()


def late_of_pyigtl(peer: Any, rate: float, seconds: float) -> list[float]:
    """Return the same of pyigtl's server, from `send_message` to the socket."""
    server, done = peer.OpenIGTLinkServer(port=0), threading.Event()

    def feed() -> None:
        while not done.wait(1.0 / rate):
            server.send_message(
                peer.TransformMessage(MATRIX, timestamp=time.time(), device_name="a"), wait=False
            )

    feeder = threading.Thread(target=feed)
    try:
        with socket.create_connection(("127.0.0.1", server.socket.getsockname()[1])) as far:
            feeder.start()
            return late(far, seconds)
    finally:
        done.set()
        feeder.join()
        server.stop()


def by_the_library(count: int) -> str:
    """Return how many transforms a second the C++ library takes of ours, and how many it found damaged."""
    prefix = os.environ.get("IGTL_PREFIX", "/usr")
    with tempfile.TemporaryDirectory() as folder:
        program = f"{folder}/igtl_client"
        flags = ["-O2", "-w", f"-I{prefix}/include/openigtlink", f"-L{prefix}/lib"]
        source = str(HERE / "igtl_client.cpp")
        try:
            subprocess.run(
                ["g++", *flags, source, "-lOpenIGTLink", "-lpthread", "-o", program],
                check=True,
                capture_output=True,
            )
        except (OSError, subprocess.CalledProcessError):
            return "not run: libopenigtlink-dev or g++ is not installed"
        return _counted(program, f"{prefix}/lib", count)


def _counted(program: str, library: str, count: int) -> str:
    done = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        arguments = [program, str(listening.getsockname()[1]), str(count)]
        with subprocess.Popen(
            arguments, stdout=subprocess.PIPE, text=True, env={"LD_LIBRARY_PATH": library}
        ) as client:
            near, _ = listening.accept()
            connection = Connection(near, "C++", Counting())
            connection.start()
            feeder = threading.Thread(target=feeding, args=(connection, done))
            feeder.start()
            told, _ = client.communicate(timeout=120.0)
            done.set()
            feeder.join()
            connection.end()
            connection.join(5.0)
    good, bad, rate = told.split()
    return f"{float(rate):.0f}, {good} whole, {bad} damaged"


def codec_rows(peer: Any) -> list[tuple[str, ...]]:
    """Return what one TRANSFORM costs in µs."""
    data = encode(TRANSFORM)

    decoder = StreamDecoder()

    def ours_decoded() -> None:
        decoder.feed(data)

    rows = {"encode": [lambda: encode(TRANSFORM)], "decode": [ours_decoded]}
    if peer is not None:
        theirs = peer.TransformMessage(MATRIX, device_name="arm/measured_cp")

        def theirs_decoded() -> None:
            fields = theirs.parse_header(data[: HEADER.size])
            theirs.create_message(fields["message_type"]).unpack(fields, data[HEADER.size :])

        rows["encode"].append(theirs.pack)
        rows["decode"].append(theirs_decoded)
    found = []
    for name, functions in rows.items():
        times = [float(np.median(time_calls(each, 500))) * 1e6 for each in functions]
        found.append(
            (
                name,
                f"{times[0]:.1f}",
                f"{times[1]:.1f}" if len(times) > 1 else "-",
                ratio(times[0], times[1]) if len(times) > 1 else "-",
            )
        )
    return found


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(4.0, "of each figure"))
    peer, seconds = pyigtl(), given.seconds
    show("one TRANSFORM, in µs", ("", "ours", "pyigtl", "ratio"), codec_rows(peer), [
        "pyigtl checks no checksum of what it reads."
    ])  # fmt: skip
    rows = []
    for name, ours, theirs in (
        ("sent", sent_by_us, sent_by_pyigtl),
        ("taken", taken_by_us, taken_by_pyigtl),
    ):
        here = ours(seconds)
        there = theirs(peer, seconds) if peer is not None else 0.0
        rows.append((name, f"{here:.0f}", f"{there:.0f}", ratio(here, there)))
    library = by_the_library(int(5000 * seconds))
    show(
        "TRANSFORMs a second, one peer",
        ("", "ours", "pyigtl", "ratio"),
        rows,
        [f"of ours, read by the C++ library: {library}"],
    )
    rows = [
        (
            f"the bridge at {rate:g} Hz, a device at 500 Hz",
            *spread(late_of_us(rate, seconds), 1e3, 2),
        )
        for rate in (60.0, 500.0, 1000.0)
    ]
    if peer is not None:
        rows += [
            (
                f"pyigtl's server, sending at {rate:g} Hz",
                *spread(late_of_pyigtl(peer, rate, seconds), 1e3, 2),
            )
            for rate in (60.0, 500.0)
        ]
    show("from sample to a peer's socket, in ms", ("", "p50", "p99", "max"), rows)


if __name__ == "__main__":
    main()
