"""T3: the device's clock is compared by the samples that did not have to wait."""

from __future__ import annotations

import numpy as np
import pytest

from crtk_drivers.labs.bench.acquisition import Subject
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.samples import JointState, vector
from crtk_drivers.testing.loopback import ROTARY

T3 = next(test for test in TESTS if test.id == "T3")
SUBJECT = Subject(("joint_1",), (ROTARY,), 100.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.1)
AT_ZERO = JointState(position=vector([0.0]))


@pytest.mark.parametrize(
    ("drift", "verdict"), [(0.0, Verdict.PASS), (400e-6, Verdict.PASS), (800e-6, Verdict.FAIL)]
)
def test_a_machine_that_grows_busy_is_no_clock_that_is_slow(drift: float, verdict: Verdict) -> None:
    random = np.random.default_rng(3)
    made = np.arange(0.0, 8.0, 0.01)
    waited = random.exponential(1e-3 + 5e-3 * made / 8.0)
    arrivals = np.round(1e9 * (1.0 + made + 2e-4 + waited)).astype(int).tolist()
    stamps = np.round(1e9 * (1.0 + made * (1.0 + drift) - 1e-2)).astype(int).tolist()
    rows = [("measured_js", at, stamp, AT_ZERO) for at, stamp in zip(arrivals, stamps, strict=True)]
    found = T3.analyse(Trace.of(rows), SUBJECT)
    assert found.verdict is verdict, found
