"""Real-time priority of a thread, where the system permits it (`crtk-driver check` says so)."""

from __future__ import annotations

import logging
import os

logger = logging.getLogger(__name__)


def ask_for_real_time(priority: int) -> None:
    """Run the calling thread, and no process that it starts, before all that is not real-time.

    Where the system does not permit it, nothing happens.

    Args:
        priority: of SCHED_FIFO, from 1 on; above that of ordinary threads, below the kernel's own.
    """
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except PermissionError:
        logger.debug("real-time priority is not permitted; see `crtk-driver check`")
