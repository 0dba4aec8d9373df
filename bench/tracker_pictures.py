"""Pictures for the pages on calibration and OpenIGTLink: ``python -m bench.tracker_pictures`` draws them."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import Final

import numpy as np

import crtk_drivers
from bench.calibration import tip_error
from crtk_drivers.front.openigtlink import Bridge, Server
from crtk_drivers.front.openigtlink.bodies import Transform
from crtk_drivers.front.openigtlink.codec import Message, StreamDecoder
from crtk_drivers.labs.tapes.svg_canvas import svg_of_plot
from crtk_drivers.labs.verdicts.judging import Plot, Series

DOCS: Final = Path(__file__).parents[1] / "docs"
COUNTS: Final = (20, 30, 50, 80, 130, 200)
TILTS: Final = (10, 20, 40)
TRIALS: Final = 40
SECONDS: Final = 8.0
HIDDEN: Final = (3.0, 1.5)
"""Seconds from the beginning at which the pointer is hidden, and for how long."""
STYLE: Final = (
    "<style>svg{--ink:#24292f;--faint:#57606a;--line:#d0d7de}</style>"
    '<rect width="100%" height="100%" fill="#ffffff"/>'
)
"""Of a plot that stands alone: the colours that a page would give it."""


def alone(plot: Plot) -> str:
    """Return a plot as an SVG file."""
    return svg_of_plot(plot).replace("<title>", f"{STYLE}<title>", 1)


def tips() -> Plot:
    """Return how far the tip of a pointer is off, by the number of its poses and how far it was tilted."""
    lines = []
    for degrees in TILTS:
        off = [1e3 * tip_error(count, np.radians(degrees), TRIALS)[0] for count in COUNTS]
        lines.append(Series(f"tilted by up to {degrees} degrees", COUNTS, tuple(off)))
    title = "RMS error of a pointer's tip; the tracker's is 0.25 mm in each coordinate"
    return Plot(title, "poses", "mm", tuple(lines))


def told() -> Plot:
    """Return what a peer is told of a pointer of a simulated tracker, which is hidden for a while."""
    found: list[tuple[float, float, float]] = []
    with (
        crtk_drivers.connect("ndi", sim=True) as tracker,
        Bridge({"ptr": tracker.pointer}, only=["measured_cp"]) as bridge,
    ):
        tracker.enable()
        server = Server(bridge, port=0)
        server.start()
        try:
            with socket.create_connection(("127.0.0.1", server.port)) as peer:
                decoder, begin, is_hidden = StreamDecoder(), time.monotonic(), False
                while (now := time.monotonic() - begin) < SECONDS:
                    if not is_hidden and now > HIDDEN[0]:
                        is_hidden = True
                        tracker.sim.control.inject(
                            "hide", tool=0, how="missing", duration=HIDDEN[1]
                        )
                    for each in decoder.feed(peer.recv(65536)):
                        if isinstance(each, Message) and isinstance(each.body, Transform):
                            x, y, _ = each.body.matrix[:3, 3].tolist()
                            found.append((each.stamp_ns * 1e-9, x, y))
        finally:
            server.close()
    stamps, xs, ys = zip(*found, strict=True)
    times = tuple(stamp - stamps[0] for stamp in stamps)
    seen = ("x", times, xs), ("y", times, ys)
    title = "A simulated pointer as a peer is told of it; it is hidden from 3 s to 4.5 s"
    return Plot(title, "time, s", "mm", tuple(Series(*each) for each in seen))


def main() -> None:
    """Draw both."""
    for name, plot in (("openigtlink", told()), ("calibration", tips())):
        text = alone(plot)
        (DOCS / f"{name}.svg").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
