"""The force sensor at its simulator: contract, values, and what goes wrong on its way."""

from __future__ import annotations

import math
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_schunk.fts import PLUGIN  # noqa: E402
from crtk_drivers.errors import CommandRefused, DeviceError  # noqa: E402
from crtk_drivers.samples import Wrench, vector  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.state import OperatingState  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.schunk.fts import RunningSim  # noqa: E402
from rigs.fts_bench import LOAD, FtsBench, configuration, fts_bench, simulated  # noqa: E402
from rigs.waiting import LONG, eventually  # noqa: E402

ENABLED, DISABLED, FAULT = OperatingState.ENABLED, OperatingState.DISABLED, OperatingState.FAULT


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with simulated() as sim:
        yield sim


class TestFts(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, shared: RunningSim) -> Iterator[Session]:
        self.sim = shared
        yield Session(PLUGIN, configuration(shared))
        shared.control.clear()

    def silence(self, session: Session) -> None:
        """Neither its stream nor an answer comes any more."""
        self.inject(session, "unplugged")
        self.inject(session, "silence")

    def break_link(self, session: Session) -> None:
        self.sim.control.inject("unplugged")
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        self.sim.control.clear()


@pytest.fixture
def bench(shared: RunningSim) -> Iterator[FtsBench]:
    """A driver, enabled."""
    shared.control.clear()
    with fts_bench(shared) as running:
        running.front.enable()
        yield running
    shared.control.clear()


def test_loads_are_newtons_and_newton_metres(bench: FtsBench) -> None:
    assert bench.load() == pytest.approx(LOAD, abs=1e-5)
    assert bench.front.measured_cf().frame_id == "ft_sensor"
    assert bench.counter("lost") == 0
    assert [note.text for note in bench.front.health().notes] == ["FTS simulated"]


def test_a_bias_in_software_and_one_in_the_sensor(bench: FtsBench) -> None:
    assert "-20" in bench.front.bias()
    eventually(lambda: np.abs(bench.load()).max() < 1e-4, "zero")
    assert bench.front.raw.measured_cf().force[2] == pytest.approx(-20.0)
    bench.front.unbias()
    eventually(lambda: bench.load()[2] < -19.0, "as it is")
    assert "it measures [0, 0, 0]" in bench.front.sensor_bias()
    assert bench.front.raw.measured_cf().force[2] == pytest.approx(0.0)
    assert "-20" in bench.front.sensor_unbias()
    bench.front.set_bias(Wrench(vector([0.0, 0.0, -20.0]), vector([0.0] * 3)))
    eventually(lambda: abs(bench.load()[2]) < 1e-4, "zero again")
    for wrong in (math.nan, 1e9):
        with pytest.raises(CommandRefused):
            bench.front.set_bias(Wrench(vector([wrong, 0.0, 0.0]), vector([0.0] * 3)))
    with pytest.raises(CommandRefused):
        bench.front.set_bias(Wrench(vector([0.0] * 3), vector([0.0] * 3), "elsewhere"))


def test_a_service_that_is_refused_says_why(bench: FtsBench) -> None:
    bench.sim.control.inject("refuses", code=4)
    with pytest.raises(DeviceError, match="busy"):
        bench.front.sensor_bias()
    bench.state(ENABLED)


@pytest.mark.parametrize(
    ("kind", "parameters", "counters"),
    [
        ("loss", {"every": 10, "burst": 2}, ("lost",)),
        ("duplicate", {"every": 10}, ("duplicates",)),
        ("late", {"every": 20, "by": 3}, ("late",)),
        ("short", {"every": 10}, ("malformed", "lost")),
        ("long", {"every": 10}, ("malformed", "lost")),
        ("empty", {"every": 10}, ("malformed",)),
        ("foreign", {"every": 2}, ()),
    ],
)
def test_what_goes_wrong_on_the_way_is_counted_and_no_value_is_wrong(
    bench: FtsBench, kind: str, parameters: dict[str, Any], counters: tuple[str, ...]
) -> None:
    before = {name: bench.counter(name) for name in ("lost", "duplicates", "late", "malformed")}
    bench.sim.control.inject(kind, **parameters)
    for _ in range(5):
        bench.received(40)
        assert bench.load() == pytest.approx(LOAD, abs=1e-5)
    bench.sim.control.clear()
    bench.received(40)
    grown = {name for name, count in before.items() if bench.counter(name) > count}
    assert grown == set(counters)
    bench.state(ENABLED)


@pytest.mark.parametrize(
    ("bits", "text"), [(1 << 0, "not ready"), (1 << 1, "invalid"), (1 << 3, "hardware")]
)
def test_an_error_of_the_sensor_is_a_fault_and_its_values_are_invalid(
    bench: FtsBench, bits: int, text: str
) -> None:
    bench.sim.control.inject("status", bits=bits)
    bench.state(FAULT, text)
    eventually(lambda: bench.session.engine.feedback("measured_cf")[1].wall_ns == 0, "invalid")
    with pytest.raises(DeviceError, match=text):
        bench.front.enable()
    bench.sim.control.clear()
    eventually(lambda: bench.session.engine.feedback("measured_cf")[1].wall_ns, "valid")
    eventually(lambda: not bench.session.engine.device.condition.reason, "over")
    bench.front.enable()


@pytest.mark.parametrize("policy", ["flag", "invalid", "fault"])
def test_too_much_is_told_as_it_is_configured(shared: RunningSim, policy: str) -> None:
    with fts_bench(shared, on_saturation=policy) as bench:
        bench.front.enable()
        bench.sim.control.inject("push", wrench=[0.0, 0.0, 600.0, 0.0, 0.0, 0.0])
        eventually(
            lambda: any("mechanical" in note.text for note in bench.front.health().notes), "told"
        )
        if policy == "fault":
            bench.state(FAULT, "mechanical")
        else:
            eventually(lambda: is_valid(bench) is (policy == "flag"), "judged as configured")
            bench.state(ENABLED)
        bench.sim.control.clear()
        eventually(
            lambda: not any("mechanical" in note.text for note in bench.front.health().notes),
            "over",
        )


def is_valid(bench: FtsBench) -> bool:
    return bool(bench.session.engine.feedback("measured_cf")[1].wall_ns)


def test_a_stream_that_another_client_stops_is_asked_for_again(bench: FtsBench) -> None:
    bench.sim.control.inject("stopped")
    eventually(lambda: bench.counter("asked_again") > 0, "asked")
    bench.received(100)
    bench.state(ENABLED)


@pytest.mark.parametrize("kind", ["stall", "unplugged"])
def test_silence_is_a_fault_and_ends_disabled(shared: RunningSim, kind: str) -> None:
    with fts_bench(shared, sample_timeout=0.5, open_timeout=1.0) as bench:
        bench.front.enable()
        bench.sim.control.inject(kind)
        bench.state(FAULT)
        bench.sim.control.clear()
        bench.connected()
        bench.state(DISABLED)
        assert any("Set the bias anew" in note.text for note in bench.front.health().notes)


def test_a_sensor_that_was_restarted_is_connected_anew(bench: FtsBench) -> None:
    bench.received(1500)
    reconnects = bench.front.health().reconnects
    bench.sim.control.inject("restart")
    eventually(lambda: bench.front.health().reconnects > reconnects, "connected again")
    bench.connected()
    bench.state(DISABLED)


def test_loads_that_are_no_numbers_end_the_connection(bench: FtsBench) -> None:
    bench.sim.control.inject("not_a_number")
    bench.state(FAULT)
    assert bench.counter("malformed") > 100


@pytest.mark.parametrize(("rate", "mode"), [(500, 1), (100, 3)])
def test_the_output_rate_is_written_if_it_is_given(rate: int, mode: int) -> None:
    with simulated() as sim:
        with fts_bench(sim, output_rate=rate, rate=100.0) as bench:
            bench.received(rate)
            assert sim.control.status()["mode"] == mode
            assert bench.counter("lost") == 0
            eventually(
                lambda: abs(bench.counter("record_rate") - rate) < 0.2 * rate, "the rate is known"
            )
        with fts_bench(sim) as bench:
            assert sim.control.status()["mode"] == mode, "left as it is"


def test_old_firmware_knows_one_port_only() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = probe.getsockname()[1]
    with simulated(old_firmware=True, udp_port=port) as sim:
        other = FtsBench(sim, configuration(sim))
        other.session.start()
        try:
            assert "54843" in other.state(FAULT, "takes no UDP port")
        finally:
            other.front.close()


def test_a_port_that_somebody_has_is_told(shared: RunningSim) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", 0))
        port = other.getsockname()[1]
        config = configuration(shared).model_copy(update={"udp_port": port})
        running = FtsBench(shared, config)
        running.session.start()
        try:
            assert "Another program" in running.state(FAULT, f"UDP port {port}")
        finally:
            running.front.close()
