"""Wired tools by where they are plugged in: two on one plug, two alike, and those without a definition."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from crtk_driver_ndi.device import NdiDevice
from crtk_drivers.cli import main
from crtk_drivers.errors import ConnectionFailed, CrtkError
from crtk_sim_backends.ndi.handles import make_rom
from crtk_sim_backends.process import RunningSim
from rigs.ndi_bench import NdiBench, configuration, ndi_bench, simulated, write_rom
from rigs.waiting import LONG

APART = 0.04
"""m between two simulated tools, along x: which one it is."""


def x_of(bench: NdiBench, tool: str) -> int:
    """Return which of the simulator's sensors a tool is, by where the simulator has it."""
    return round(float(getattr(bench.front, tool).measured_cp(wait=LONG).position[0]) / APART)


def scanned(sim: RunningSim, capfd: pytest.CaptureFixture[str]) -> str:
    assert main(["ndi", "scan", "--host", sim.host, "--tcp-port", str(sim.ports["tcp"])]) == 0
    return capfd.readouterr().out


def test_a_wired_tool_without_memory_gets_its_definition(tmp_path: Path) -> None:
    """One sensor, as of an Aurora; written to the handle that its port has already."""
    path = tmp_path / "probe.rom"
    path.write_bytes(make_rom("PROBE", markers=((0, 0, 0),)))
    tools = [{"name": "probe", "rom": str(path), "port": 2}]
    with (
        simulated(family="aurora", wired="A,?", motion="still", noise=0.0) as sim,
        ndi_bench(sim, tools=tools) as bench,
    ):
        bench.tracking()
        assert x_of(bench, "probe") == 1


def test_an_aurora_has_no_wireless_tools(tmp_path: Path) -> None:
    with simulated(family="aurora", wired="?") as sim:
        device = NdiDevice(configuration(sim, tools=[{"rom": write_rom(tmp_path, "W")}]))
        with pytest.raises(ConnectionFailed, match=r"cannot be used: PHRQ.* port beside rom"):
            _open(device)


def test_one_sensor_alone_is_refused_as_wireless(tmp_path: Path) -> None:
    path = tmp_path / "probe.rom"
    path.write_bytes(make_rom("PROBE", markers=((0, 0, 0),)))
    with simulated(family="aurora", wired="?") as sim:
        device = NdiDevice(configuration(sim, tools=[{"rom": str(path)}]))
        with pytest.raises(ConnectionFailed, match=r"1 of the 3 markers .*port of the wired tool"):
            _open(device)


def _open(device: NdiDevice) -> None:
    try:
        device.open(time.monotonic() + LONG)
    finally:
        device.close()


@pytest.mark.parametrize("family", ["aurora", "vega"])
@pytest.mark.parametrize(
    "keys",
    [
        [{"part_number": "DUAL", "channel": 1}, {"part_number": "DUAL", "channel": 0}],
        [{"port": 1, "channel": 1}, {"port": 1}],
    ],
)
def test_two_channels_of_one_plug_are_told_apart(family: str, keys: list[dict[str, Any]]) -> None:
    tools = [{"name": name, **each} for name, each in zip(("second", "first"), keys, strict=True)]
    with (
        simulated(family=family, wired="DUAL*2", motion="still", noise=0.0) as sim,
        ndi_bench(sim, tools=tools) as bench,
    ):
        bench.tracking()
        assert (x_of(bench, "first"), x_of(bench, "second")) == (0, 1)


@pytest.mark.parametrize(
    ("wired", "told"),
    [
        ("DUAL*2", ["channel = 0", "channel = 1"]),
        ("SAME,SAME", ['serial_number = "34000000"', 'serial_number = "34000001"']),
        ("ONE,OTHER", ['part_number = "ONE"', 'part_number = "OTHER"']),
    ],
)
def test_scan_names_each_sensor_apart(
    wired: str, told: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    """Each block of what it prints, taken as it is, is the sensor above which it stands."""
    with simulated(family="aurora", wired=wired) as sim:
        out = scanned(sim, capfd)
        blocks = [block.partition("\n\n")[0].strip() for block in out.split("[[tools]]")[1:]]
        assert [each in block for each, block in zip(told, blocks, strict=True)] == [True, True]
        assert len(set(blocks)) == 2
        assert "at port 1, channel 0" in out


def test_scan_says_what_a_tool_without_memory_needs(capfd: pytest.CaptureFixture[str]) -> None:
    with simulated(family="aurora", wired="A,?") as sim:
        assert "port 2, channel 0: PINIT" in (out := scanned(sim, capfd))
        assert "needs rom, beside port and channel" in out


def test_tools_that_change_with_their_plugs_are_told() -> None:
    alike = [{"name": name, "part_number": "SAME"} for name in ("left", "right")]
    apart = [
        {"name": "left", "part_number": "SAME", "serial_number": "34000001"},
        {"name": "right", "port": 1},
    ]
    with simulated(wired="SAME,SAME", motion="still", noise=0.0) as sim:
        with ndi_bench(sim, tools=alike) as bench:
            told = [note.text for note in bench.session.engine.device.notes]
            assert any("right may be what is at any of the ports 1, 2" in text for text in told), (
                told
            )
        with ndi_bench(sim, tools=apart) as bench:
            assert not any("may be" in note.text for note in bench.session.engine.device.notes)
            bench.tracking()
            assert (x_of(bench, "left"), x_of(bench, "right")) == (1, 0)


def test_the_most_closely_named_takes_its_own() -> None:
    """A tool that is named by its part number alone leaves the other its serial number's."""
    tools = [
        {"name": "any", "part_number": "SAME"},
        {"name": "this", "part_number": "SAME", "serial_number": "34000000"},
    ]
    with (
        simulated(wired="SAME,SAME", motion="still", noise=0.0) as sim,
        ndi_bench(sim, tools=tools) as bench,
    ):
        bench.tracking()
        assert (x_of(bench, "any"), x_of(bench, "this")) == (1, 0)


@pytest.mark.parametrize(
    ("tool", "words"),
    [
        ({}, "give rom, or part_number"),
        ({"rom": "a.rom", "part_number": "A"}, "not both"),
        ({"rom": "a.rom", "channel": 1}, "channel: is of a wired tool"),
        ({"port": 0}, "port"),
    ],
)
def test_a_tool_that_is_named_wrongly_is_refused(tool: dict[str, Any], words: str) -> None:
    with simulated() as sim, pytest.raises(CrtkError, match=words):
        configuration(sim, tools=[tool])
