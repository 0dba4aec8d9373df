"""The sensor's page changes while the sensor streams: what a count is worth is another at once."""

from __future__ import annotations

import urllib.request

from crtk_drivers.device import Severity
from crtk_drivers.state import OperatingState
from rigs.netft_bench import LONG, NetFtBench, eventually, netft_bench

LOAD = [0.0, 0.0, -20.0, 0.0, 0.0, 2.0]
LOAD_TEXT = "constant:fz=-20,tz=2"
NEVER = 600.0
"""Seconds between two looks at the page, where a test wants none by the clock."""


def set_on_page(bench: NetFtBench, settings: str) -> None:
    """Change the sensor's configuration as a browser does."""
    address = f"http://{bench.sim.host}:{bench.sim.ports['http']}/config.cgi?cfgid=0&{settings}"
    with urllib.request.urlopen(address, timeout=LONG) as reply:
        assert reply.status == 200


def looks(bench: NetFtBench) -> int:
    pages = bench.sim.control.status()["counters"]["pages"]
    assert isinstance(pages, int)
    return pages


def test_a_unit_changed_under_load_is_noticed_by_the_jump() -> None:
    with netft_bench({"page_period": NEVER}, load=LOAD_TEXT) as bench:
        bench.until_load(LOAD)
        bench.front.enable()
        set_on_page(bench, "cfgfu=1&cfgtu=1")
        bench.was(OperatingState.FAULT, "scale")
        bench.state(OperatingState.DISABLED)
        bench.until_load(LOAD, tolerance=1e-4)
        assert bench.device.sensor_bias == "unknown"


def test_a_unit_changed_without_a_load_is_noticed_by_the_clock() -> None:
    with netft_bench({"page_period": 0.1}) as bench:
        bench.front.enable()
        set_on_page(bench, "cfgtu=2")
        bench.was(OperatingState.FAULT, "scale")
        bench.state(OperatingState.DISABLED)
        bench.sim.control.inject("push", wrench=LOAD)
        bench.until_load(LOAD, tolerance=1e-4)


def test_a_unit_changed_is_noticed_also_where_the_scale_is_typed_in() -> None:
    typed = {"counts_per_force": 1e6, "counts_per_torque": 1e6}
    with netft_bench({"page_period": 0.1, "scale": typed}) as bench:
        set_on_page(bench, "cfgfu=1")
        bench.was(OperatingState.FAULT, "scale")


def test_over_tcp_without_a_page_the_scale_is_asked_for_again() -> None:
    typed = {"counts_per_force": 1e6, "counts_per_torque": 1e6}
    config = {"page_period": 0.05, "http": False, "scale": typed, "transport": "tcp"}
    with netft_bench(config, load=LOAD_TEXT) as bench:
        bench.until_load(LOAD, tolerance=0.05)
        bench.front.enable()
        received = bench.counter("received")
        eventually(lambda: bench.counter("received") > received + 100, "goes on")
        bench.state(OperatingState.ENABLED)
        set_on_page(bench, "cfgfu=1")
        bench.was(OperatingState.FAULT, "scale")
        bench.until_load(LOAD, tolerance=0.05)


def test_a_tool_transform_set_on_the_page_is_noticed() -> None:
    with netft_bench({"page_period": 0.1}) as bench:
        set_on_page(bench, "cfgtdu=3&cfgtfx2=100")
        bench.was(OperatingState.FAULT, "tool transform")


def test_a_page_that_contradicts_itself_is_a_fault_until_it_does_not() -> None:
    with netft_bench({"page_period": 0.1}, load=LOAD_TEXT) as bench:
        bench.front.enable()
        bench.sim.control.inject("web_tag", tag="cfgfu", text="1")
        bench.was(OperatingState.FAULT, "contradict")
        bench.sim.control.clear("web_tag")
        bench.state(OperatingState.DISABLED)
        bench.until_load(LOAD, tolerance=1e-4)


def test_a_web_server_that_fails_is_told_and_ends_nothing() -> None:
    with netft_bench({"page_period": 0.1, "http_timeout": 0.5}, load=LOAD_TEXT) as bench:
        bench.front.enable()
        for answer in ("server_error", "no_http", "cut_off", "silent"):
            bench.sim.control.inject("web_answer", answer=answer)
            severity, text = eventually(lambda: bench.note("page"), f"told of {answer}")
            assert severity is Severity.WARNING
            assert "was not read" in text
            bench.sim.control.clear("web_answer")
            eventually(lambda: bench.note("page") is None, f"{answer} is over")
        bench.state(OperatingState.ENABLED)
        bench.until_load(LOAD)


def test_a_load_that_jumps_all_the_time_asks_for_few_pages() -> None:
    shaken = "constant:fz=-20 + sine:axis=2,amplitude=200,frequency=20"
    with netft_bench({"page_period": NEVER}, load=shaken) as bench:
        before = looks(bench)
        bench.record(2.5)
        assert before < looks(bench) <= before + 4
        bench.state(OperatingState.DISABLED)


def test_a_period_of_zero_looks_never() -> None:
    with netft_bench({"page_period": 0.0}, load=LOAD_TEXT) as bench:
        before = looks(bench)
        bench.sim.control.inject("push", wrench=[100.0, 0, 0, 0, 0, 0])
        bench.until_load([100.0, 0.0, -20.0, 0.0, 0.0, 2.0])
        assert looks(bench) == before
