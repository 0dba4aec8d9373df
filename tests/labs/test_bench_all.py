"""The quick suite over all drivers of this package, simulated, two at a time: nothing may fail."""

from __future__ import annotations

from pathlib import Path

import pytest

from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench.acquisition import Suite
from crtk_drivers.labs.bench.allowed import BenchOptions
from crtk_drivers.labs.bench.run import run_bench
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.status.stop_request import StopRequest

DRIVERS = {
    "gantry": ("loopback", ""),
    "arm": ("virtual", "rate = 200"),
    "ur": ("ur", "frequency = 125"),
    "servos": ("dynamixel", "rate = 100"),
    "drives": ("canopen", ""),
    "ft": ("ati-netft", ""),
}
"""By the name of the device: its driver, and settings with which two cores do for two of them."""


@pytest.mark.slow
@pytest.mark.timeout(420)
def test_the_quick_suite_fails_nowhere(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        "".join(
            f'[devices.{name}]\nplugin = "{plugin}"\nsettings = {{ {settings} }}\n'
            for name, (plugin, settings) in DRIVERS.items()
        )
    )
    options = BenchOptions(Suite.QUICK, (), may_move=False, out=tmp_path / "run", at_once=2)
    run = run_bench(load_lab(path, sim=True), options, lambda *_: None, StopRequest())
    assert run.complete
    assert [device.trouble for device in run.devices] == [""] * len(DRIVERS)
    found = [(device.name, test.id, test.verdict, test.reason) for device, test in run.tests]
    assert [each for each in found if each[2] is Verdict.FAIL] == []
    passed = {(name, test) for name, test, verdict, _ in found if verdict is Verdict.PASS}
    assert passed >= {(name, "T3") for name in DRIVERS}, "what no busy machine leaves open"
