"""A command for people: which boards are there."""

from __future__ import annotations

import time
from typing import Final

from rich.console import Console

from crtk_driver_dvrk.boards import Boards
from crtk_driver_dvrk.config import DvrkConfig
from crtk_drivers.config import Settings
from crtk_drivers.plugins import Tool, required

_OUT = Console(highlight=False)


class NoOptions(Settings):
    """No options."""


def scan(config: DvrkConfig, options: NoOptions) -> int:
    """Print the boards of a controller; 1 if a number is there twice."""
    boards = Boards(config.host, config.udp_port, config.told_at, config.reply_timeout)
    try:
        found = boards.open(time.monotonic() + config.open_timeout)
    finally:
        boards.close()
    for each in found:
        _OUT.print(
            f"Node {each.node}, BoardId {each.board}, FPGA_V{each.fpga}, {each.hardware_name}, "
            f"firmware {each.firmware}",
            markup=False,
        )
    numbers = [each.board for each in found]
    twice = sorted({number for number in numbers if numbers.count(number) > 1})
    for number in twice:
        _OUT.print(f"BoardId {number} is there twice: set a rotary switch otherwise.", markup=False)
    return 1 if twice else 0


TOOLS: Final = (
    Tool(
        "scan",
        "tell which boards are there, and their firmware",
        scan,
        NoOptions,
        check_real=required("host", "169.254.0.100"),
    ),
)
