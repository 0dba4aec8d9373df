"""Clients that others have written, unmodified, at the simulated tracker.

They are not in the group `test`:
``uv run --group test --with ndicapi --with scikit-surgerynditracker pytest -m "" tests/ndi/sim -k ndicapi``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from crtk_sim_backends.process import RunningSim
from rigs.ndi_bench import simulated, write_rom

pytestmark = pytest.mark.slow


@pytest.fixture(params=["vega", "aurora"])
def sim(request: pytest.FixtureRequest) -> Iterator[RunningSim]:
    with simulated(family=request.param, motion="still", noise=0.0) as running:
        yield running


def middle(sim: RunningSim) -> float:
    return {60.0: -1500.0, 40.0: -250.0}[sim.control.status()["rate"]]


@pytest.mark.parametrize("way", ["network", "serial"])
def test_ndicapi(sim: RunningSim, way: str) -> None:
    ndicapy = pytest.importorskip("ndicapy")
    if way == "network":
        device = ndicapy.ndiOpenNetwork(sim.host, sim.ports["tcp"])
    else:
        device = ndicapy.ndiOpen(sim.ttys["serial"])

    def ask(text: str) -> str:
        told: str = ndicapy.ndiCommand(device, text)
        assert ndicapy.ndiGetError(device) == ndicapy.NDI_OKAY, text
        return told

    try:
        ask("INIT:")
        for handle in ("01", "02"):
            assert handle in ask("PHSR:02")
            ask(f"PINIT:{handle}")
            ask(f"PENA:{handle}D")
        ask("TSTART:80")
        ask("TX:0801")
        seen = ndicapy.ndiGetTXTransform(device, b"\x01")
        assert len(seen) == 8
        assert seen[4:7] == pytest.approx((0.0, 0.0, middle(sim)), abs=0.01)
        assert math.hypot(*seen[:4]) == pytest.approx(1.0, abs=1e-3)
        with pytest.raises(OSError, match="invalid while in the current mode"):
            ndicapy.ndiCommand(device, "PINIT:01")
        ask("TSTOP:")
    finally:
        (ndicapy.ndiCloseNetwork if way == "network" else ndicapy.ndiClose)(device)


def test_scikit_surgerynditracker_by_ndicapi(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With two tools: a third makes its own decoder fail (its issue 67)."""
    tracking = pytest.importorskip("sksurgerynditracker.nditracker")
    ping = tmp_path / "ping"
    ping.write_text("#!/bin/sh\nexit 0\n")
    ping.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with simulated(family="vega", wired="", motion="still", noise=0.0) as sim:
        tracker = tracking.NDITracker(
            {
                "tracker type": "vega",
                "ip address": sim.host,
                "port": sim.ports["tcp"],
                "romfiles": [write_rom(tmp_path, "A"), write_rom(tmp_path, "B")],
            }
        )
        try:
            tracker.start_tracking()
            _, _, _, poses, quality = tracker.get_frame()
            places = [pose[:3, 3] for pose in poses]
            assert places[0] == pytest.approx([0.0, 0.0, -1500.0], abs=0.01)
            assert places[1] == pytest.approx([40.0, 0.0, -1500.0], abs=0.01)
            assert quality == pytest.approx([0.1, 0.1], abs=1e-3)
            tracker.stop_tracking()
        finally:
            tracker.close()
