"""The controller's watchdog, as rarely fed as a busy machine needs: less often than users may choose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from unittest.mock import patch

from crtk_driver_ur import device
from crtk_driver_ur.config import UrConfig
from crtk_driver_ur.control_options import ControlOptions
from crtk_driver_ur.models import RobotModel

FREQUENCY = 0.5
"""Hz. Of the least that users may have, 2 Hz, a driver that gets no time for half a second is stopped."""


@contextmanager
def rarely_fed() -> Iterator[None]:
    """Let control programs that begin within wait as long for their driver."""
    given = device._control_options

    def options_of(config: UrConfig, model: RobotModel) -> ControlOptions:
        options = given(config, model)
        return replace(options, watchdog_frequency=min(options.watchdog_frequency, FREQUENCY))

    with patch.object(device, "_control_options", options_of):
        yield
