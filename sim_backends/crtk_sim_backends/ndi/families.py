"""What each family of trackers is and does: names, rates, volumes, dialects. Data alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

FREQUENCY: Final = "Param.Tracking.Track Frequency"
STEPS: Final[Mapping[str, int]] = {"0": 3, "1": 2, "2": 1}
"""By how much frame numbers rise, by the value of that parameter: 20, 30 or 60 Hz of 60."""


@dataclass(frozen=True)
class Family:
    """One family.

    Attributes:
        firmware: the first line of VER.
        version: what VER:5 says.
        api: what APIREV says; empty where the command is not known.
        rate: frames a second.
        middle: of the volume, where tools are by default, in mm.
        near, far: of the volume, along z, in mm.
        half: width of the volume at its far end, in mm, to each side.
        model: of GET Features.Hardware.Model; empty where GET is not known.
        bx2: whether it knows BX2.
        long_replies: whether it sends BX2 replies with the long header, which has no check.
        one_by_one: a wired tool shows up when that before it has been initialised.
        indicator: its error is a number without unit.
        version_error: what VER answers to a number that it does not have.
    """

    firmware: str
    version: str
    api: str
    rate: float
    middle: float
    near: float
    far: float
    half: float
    model: str = ""
    bx2: bool = False
    long_replies: bool = False
    one_by_one: bool = False
    indicator: bool = False
    version_error: int = 0x07

    def told(self, serial_number: str) -> str:
        """Return what VER says."""
        return (
            f"{self.firmware}\nNDI S/N: {serial_number}\nCharacterization Date: 01/02/20\n"
            f"Freeze Tag: simulated {self.model}\nFreeze Date: 01/02/20\n(C) Northern Digital Inc.\n"
        )


def _polaris(
    firmware: str, rate: float, model: str = "", api: str = "", version: str = "024"
) -> Family:
    return Family(
        firmware, version, api, rate, -1500.0, -950.0, -2400.0, 900.0, model, bx2=bool(model)
    )


FAMILIES: Final[Mapping[str, Family]] = {
    "vicra": Family("Polaris Vicra Control Firmware", "018", "", 20.0, -950.0, -557.0, -1336.0, 470.0),
    "spectra": _polaris("Polaris Spectra Control Firmware", 60.0),
    "vega": _polaris("Polaris Vega Control Firmware", 60.0, "Polaris Vega ST", "G.003.005"),
    "vega-vt": _polaris("Polaris Vega Control Firmware", 120.0, "Polaris Vega VT", "G.003.005"),
    "vega-xt": _polaris("Polaris Vega Control Firmware", 400.0, "Polaris Vega XT", "G.003.005"),
    "lyra": Family(
        "Polaris Lyra Control Firmware", "024", "G.003.005", 60.0, -550.0, -400.0, -800.0, 250.0,
        "Polaris Lyra", bx2=True,
    ),
    "aurora": Family(
        "Aurora Control Firmware", "013", "D.001.007", 40.0, -250.0, -50.0, -550.0, 250.0,
        "Aurora", bx2=True, long_replies=True, one_by_one=True, indicator=True, version_error=0x23,
    ),
}  # fmt: skip
