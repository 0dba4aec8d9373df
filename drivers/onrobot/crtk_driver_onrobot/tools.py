"""Commands for people: which tool is there, and what it reports."""

from __future__ import annotations

import time
from typing import Any, Final

from rich.console import Console

from crtk_driver_onrobot.config import OnRobotConfig
from crtk_drivers.plugins import Tool

__all__ = ["TOOLS"]


def _info(config: OnRobotConfig, options: Any) -> int:
    from crtk_driver_onrobot.device import Talk

    talk = Talk(config)
    try:
        status = talk.open(time.monotonic() + config.open_timeout, lambda: False)
    finally:
        talk.close()
    console = Console(highlight=False)
    console.print(f"{'tool':<24}{status.identity.title}, firmware {status.identity.firmware}")
    for address, word in sorted(status.words.items()):
        console.print(f"{f'register {address:#06x}':<24}{word}")
    return 0


TOOLS: Final = (
    Tool("info", "tells which tool is there, and its registers; writes nothing", _info),
)
