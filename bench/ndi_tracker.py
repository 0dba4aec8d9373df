"""An NDI tracker: what a frame costs to decode, how many can be asked for, how late they come, their stamps.

The tracker is the simulated one, over TCP on this machine: it takes a frame when its clock says so and tells
it to whoever asks, so latency is what driver, questions and sockets add. Beside it ndicapi's client in C, if
that is installed (``uv run --group test --with ndicapi python -m bench.ndi_tracker``); its wheel has no BX2.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import count

from bench.report import options, show, spread
from crtk_driver_ndi import PLUGIN
from crtk_driver_ndi.codec import reply_decoder
from crtk_driver_ndi.config import NdiConfig
from crtk_driver_ndi.device import NdiDevice
from crtk_driver_ndi.frames import PARSERS
from crtk_driver_ndi.link import NdiLink
from crtk_driver_ndi.setup import prepare
from crtk_drivers.session import Session
from crtk_sim_backends.ndi import SIM, frames, wire
from crtk_sim_backends.ndi.frames import Seen
from crtk_sim_backends.ndi.motion import Place
from crtk_sim_backends.process import RunningSim

KINDS = ("TX", "BX", "BX2")
NOTE = (
    "The simulator is Python, and answers both. ndicapi decodes nothing until transforms are asked for. "
    "Most replies to BX2 are short: each frame is told once."
)


def encoded(kind: str, tools: int) -> bytes:
    """Return a reply as a tracker with so many tools sends it."""
    at = Place(10.0, 20.0, -1000.0, 1.0, 0.0, 0.0, 0.0, 0.1)
    seen = [Seen(handle, at, 0, 0x31, enabled=True) for handle in range(1, tools + 1)]
    if kind == "TX":
        return wire.words(frames.tx(seen, 7, 0, 0x0801))
    body = (
        frames.bx(seen, 7, 0, 0x0801)
        if kind == "BX"
        else frames.bx2(seen, 7, 10**18, magnetic=False)
    )
    return wire.binary(body)


def calls(function: Callable[[], object], seconds: float) -> float:
    """Return how often a second it can be called."""
    end = (begin := time.perf_counter()) + seconds
    for done in count(1):
        function()
        if (now := time.perf_counter()) > end:
            return done / (now - begin)
    raise AssertionError


def decoded(kind: str, tools: int, seconds: float) -> float:
    """Return how many replies a second become frames."""
    data, decoder, (_, parse) = encoded(kind, tools), reply_decoder(), PARSERS[kind]
    return calls(lambda: parse(decoder.feed(data)[0]), seconds)


@contextmanager
def tracking(sim: RunningSim) -> Iterator[NdiLink]:
    """A tracker with its tools, by the driver's link alone."""
    config = PLUGIN.sim_config(NdiConfig(), sim)
    link, deadline = NdiLink(config), time.monotonic() + 10.0
    link.open(deadline)
    prepare(link, config.tools, None, deadline)
    link.ask("TSTART:80", deadline)
    try:
        yield link
    finally:
        link.ask("TSTOP:", time.monotonic() + 1.0)
        link.close()


def asked(link: NdiLink, kind: str, seconds: float) -> float:
    """Return how many replies a second come, one question after the other."""
    question, parse = PARSERS[kind]
    return calls(lambda: parse(link.ask(question, time.monotonic() + 1.0)), seconds)


def asked_by_ndicapi(sim: RunningSim, kind: str, seconds: float) -> float:
    """Return the same of ndicapi, while the tracker tracks."""
    import ndicapy  # type: ignore[import-not-found]

    device = ndicapy.ndiOpenNetwork(sim.host, sim.ports["tcp"])
    try:
        return calls(lambda: ndicapy.ndiCommand(device, f"{kind}:0801"), seconds)
    finally:
        ndicapy.ndiCloseNetwork(device)


def followed(
    family: str, kind: str, seconds: float
) -> tuple[Sequence[float], Sequence[float], float]:
    """Return latency and stamp error of each frame of a whole driver, in s, and the share that was lost."""
    late: list[float] = []
    wrong: list[float] = []
    with SIM.spawn(family=family) as sim:
        config = PLUGIN.sim_config(NdiConfig(family=family, replies=kind), sim)
        session, enabled = Session(PLUGIN, config), threading.Event()
        device, pointer = session.engine.device, session.children["pointer"]
        assert isinstance(device, NdiDevice)
        with session:
            while not all(engine.has_sample for engine in session.engines):
                time.sleep(0.01)
            session.engine.state_command("enable")
            while (stream := device.stream) is None:
                time.sleep(0.01)
            status = sim.control.status()

            def take() -> None:
                now, newest = time.monotonic(), stream.newest
                if newest is not None and stream.frames > 2.0 * status["rate"]:
                    taken = status["origin"] + newest.number / status["rate"]
                    late.append(now - taken)
                    wrong.append(stream.stamp.monotonic - taken)

            pointer.on_sample = take
            enabled.wait(2.0 + seconds)
            pointer.on_sample = None
            return late, wrong, stream.lost / (stream.frames + stream.lost)


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(5.0, "of each figure"), tools=(2, "in a decoded reply"))
    short = given.seconds / 5.0
    rows = []
    has_peer = find_spec("ndicapy") is not None
    with SIM.spawn(family="vega") as sim, tracking(sim) as link:
        for kind in KINDS:
            peer = (
                f"{asked_by_ndicapi(sim, kind, short):.0f}" if has_peer and kind != "BX2" else "-"
            )
            rows.append(
                (
                    kind,
                    f"{decoded(kind, given.tools, short):.0f}",
                    f"{asked(link, kind, short):.0f}",
                    peer,
                )
            )
    show(
        f"frames a second, {given.tools} tools",
        ("asked by", "decoded", "asked for, driver's link", "asked for, ndicapi (C)"),
        rows,
        [NOTE],
    )
    rows = []
    for family in ("vega", "vega-xt"):
        for kind in ("BX", "BX2"):
            late, wrong, lost = followed(family, kind, given.seconds)
            off = [abs(value) for value in wrong]
            figures = (*spread(late, 1e3, 2), *spread(off, 1e3, 2), f"{100.0 * lost:.2f}")
            rows.append((f"{family}, {kind}", f"{len(late)}", *figures))
    show(
        "from frame to callback, and error of the stamp, in ms",
        ("", "frames", "p50", "p99", "max", "stamp p50", "p99", "max", "lost, %"),
        rows,
    )


if __name__ == "__main__":
    main()
