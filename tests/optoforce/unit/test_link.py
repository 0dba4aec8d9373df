"""How old measurements are: by their numbers, where what lay waiting comes late."""

from __future__ import annotations

import pytest

from crtk_driver_optoforce.config import OptoForceConfig
from crtk_driver_optoforce.frames import Measurement
from crtk_driver_optoforce.link import Batch, OptoForceLink

RATE = 1000


def measured(*numbers: int) -> list[Measurement]:
    return [Measurement(number, 0, (0,) * 3) for number in numbers]


def test_what_waited_is_as_old_as_it_is() -> None:
    """A process that was stopped for 3 s finds what its port could keep, which is the oldest."""
    link = OptoForceLink(OptoForceConfig(port="/dev/null", rate=RATE), lambda: False)

    def at(now: float, *numbers: int) -> Batch:
        batch = link._batch(measured(*numbers), now)
        assert batch is not None
        return batch

    at(100.0, 0)
    at(100.001, 1)
    late = at(103.001, *range(2, 102))
    more = at(103.001, *range(102, 202))
    assert late.times[-1] == pytest.approx(100.101, abs=1e-6)
    assert late.times[0] == pytest.approx(100.002, abs=1e-6)
    assert more.times[-1] == pytest.approx(100.201, abs=1e-6)
    assert at(103.002, 3002).times[-1] == 103.002
