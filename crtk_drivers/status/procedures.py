"""Ending a procedure of a device (`crtk_drivers.device.Steps`) before its own end."""

from __future__ import annotations

import logging

from crtk_drivers.device import Answer, Steps

logger = logging.getLogger(__name__)


def close(steps: Steps | Answer | None, where: str) -> None:
    """Close `steps`, so that its ``finally`` blocks run now; what they raise is logged. I/O thread only."""
    if steps is None:
        return
    try:
        steps.close()
    except Exception:
        logger.exception("%s: a procedure that was interrupted failed to clean up", where)
