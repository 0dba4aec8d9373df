"""The options of the simulated controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

from typing_extensions import override

from crtk_sim_backends.kit import ConfigError, Options, check_port, check_range, option

HIGHEST_BOARD: Final = 15


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim dvrk``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The boards": ("boards", "firmware", "hardware", "fpga"),
        "What is driven": ("gravity", "friction", "power_delay", "patience"),
        "Ports": ("udp_port",),
        **Options.HEADINGS,
    }

    boards: str = option(
        "6,7", "numbers of the boards, by node; the first one has the Ethernet cable"
    )
    firmware: int = option(8, "version of the firmware that boards tell")
    hardware: str = option("QLA1", "what boards tell that they are, in four letters")
    fpga: int = option(3, "version of the FPGA boards: 2 or 3")
    gravity: float = option(
        0.0, "A that hold each motor against its weight; without them it falls, down to 0 counts"
    )
    friction: float = option(0.0, "A that it takes to move a motor at all")
    power_delay: float = option(0.1, "seconds from motor power to the voltage of motors")
    patience: float = option(
        1.0,
        "by how much longer than it was told a watchdog waits: on a machine that does not keep time",
    )
    udp_port: int = option(0, "UDP port of the boards (1394 on hardware); 0: any free one")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("firmware", self.firmware, 1, 100)
        check_range("fpga", self.fpga, 2, 3)
        check_range("gravity", self.gravity, 0.0, 6.0)
        check_range("friction", self.friction, 0.0, 6.0)
        check_range("power_delay", self.power_delay, 0.0, 10.0)
        check_range("patience", self.patience, 1.0, 1000.0)
        check_port("udp_port", self.udp_port)
        if len(self.hardware) != 4 or not self.hardware.isascii():
            raise ConfigError(f"hardware must be four letters, not {self.hardware!r}")
        if not 1 <= len(self.numbers) <= HIGHEST_BOARD + 1:
            raise ConfigError(f"boards: there are 1 to {HIGHEST_BOARD + 1} on a bus")
        for number in self.numbers:
            check_range("boards", number, 0, HIGHEST_BOARD)

    @property
    def numbers(self) -> list[int]:
        """Of the boards, by node.

        Raises:
            ConfigError: they are no numbers.
        """
        try:
            return [int(each) for each in self.boards.split(",")]
        except ValueError as error:
            raise ConfigError(f"boards must be numbers, as 6,7, not {self.boards!r}") from error
