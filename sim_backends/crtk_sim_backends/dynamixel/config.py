"""Configuration of simulated DYNAMIXEL buses."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from typing_extensions import override

from crtk_sim_backends.defects import read_defects
from crtk_sim_backends.dynamixel.defects import ServoDefects
from crtk_sim_backends.dynamixel.models import MODELS, Model
from crtk_sim_backends.faults import unknown
from crtk_sim_backends.options import (
    ConfigError,
    Options,
    check_choice,
    check_range,
    option,
)

_ARM6_WRIST: Final = "4:xm430-w350~0.3,5:xm430-w350~0.3,6:xm430-w350"
_KOCH: Final = "1:xl430-w250,2:xl430-w250~0.3," + ",".join(f"{n}:xl330-m288" for n in (3, 4, 5, 6))
_VX300S: Final = (
    "1:xm540-w270,2:xm540-w270~2.5,3:xm540-w270&2,4:xm540-w270~1.2,5:xm540-w270&4,"
    "6:xm540-w270,7:xm540-w270~0.5,8:xm430-w350,9:xm430-w350"
)

PRESETS: Final = {
    "arm6": f"1:xm540-w270,2:xm540-w270~2,3:xm540-w270~1,{_ARM6_WRIST},7:xm430-w350",
    "arm6_small_gripper": f"1:xm540-w270,2:xm540-w270~2,3:xm540-w270~1,{_ARM6_WRIST},7:xl330-m288",
    "arm6_shadow": (
        f"1:xm540-w270,2:xm540-w270~2,8:xm540-w270&2,3:xm540-w270~1,{_ARM6_WRIST},7:xm430-w350"
    ),
    "koch": _KOCH,
    "koch_follower": _KOCH,
    "koch_leader": ",".join(f"{n}:xl330-m077" for n in range(1, 7)),
    "open_manipulator_x": (
        "11:xm430-w350,12:xm430-w350~1,13:xm430-w350~0.6,14:xm430-w350~0.2,15:xm430-w350"
    ),
    "viperx": _VX300S,
    "vx300s": _VX300S,
}
"""Servos of arms, as text."""

_SERVO: Final = re.compile(
    r"(?P<number>\d{1,3}):(?P<model>[a-z0-9.-]+)(?:@(?P<firmware>\d{1,3}))?"
    r"(?:~(?P<gravity>\d{1,3}(?:\.\d{1,6})?))?(?:&(?P<partner>\d{1,3}))?",
    re.IGNORECASE,
)
TIMINGS: Final = ("wire", "none")
CHAINS: Final = ("stalls", "goes_on")


@dataclass(frozen=True, slots=True)
class ServoSpec:
    """One servo of a bus.

    Attributes:
        number: its id.
        gravity: N·m at a quarter turn from where it starts.
        partner: id of the servo whose joint it turns too, mounted the other way round; None: it has its own.
    """

    number: int
    model: Model
    firmware: int
    gravity: float = 0.0
    partner: int | None = None


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """Options of the simulated buses; the `help` of each field says what it is for.

    Raises:
        ConfigError: from the constructor, naming the option and what can be given instead.
    """

    servos: str = option(
        "arm6",
        "servos as ID:MODEL[@FIRMWARE][~GRAVITY][&ID], such as 1:xm430-w350@52~0.5,2:xl330-m288; "
        "GRAVITY in N.m, &ID: on the shaft of that servo as its shadow; ';' begins another bus. "
        f"Or one of {', '.join(PRESETS)}",
    )
    baud: int = option(1_000_000, "bits a second that the servos are set to")
    return_delay: int = option(250, "Return Delay Time of the servos, in 2 us")
    timing: str = option(
        "wire", "'wire': bytes take the time that they take at the baud rate; 'none': none", TIMINGS
    )
    adapter_latency: float = option(
        0.0, "latency timer of the USB adapter in ms (such as 1 or 16); 0: none"
    )
    chain: str = option(
        "stalls",
        "what servos do that come behind a missing one in a group read: 'stalls', 'goes_on'",
        CHAINS,
    )
    speed: float = option(1.0, "how many times faster than real time the mechanics are")
    link: str = option(
        "", "path of a symbolic link to the tty that stays the same; one in a new folder if empty"
    )
    tcp_port: int = option(
        0,
        "TCP port by which the first bus can be reached too, further ones follow; 0: any free ones",
    )
    defects: str = option(
        "",
        "what is wrong with servos, such as 'position_noise=1e-3,joints=2+3;backlash=0.01,joints=5'",
    )
    seed: int = option(0, "seed of everything random")
    trace_size: int = option(5000, "how many received instructions the trace keeps")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        for name, choices in (("timing", TIMINGS), ("chain", CHAINS)):
            check_choice(name, getattr(self, name), choices)
        for name, low, high in _BOUNDS:
            check_range(name, getattr(self, name), low, high)
        _ = self.buses
        _ = self.wrong

    @property
    def buses(self) -> list[list[ServoSpec]]:
        """The servos of every bus."""
        return [parse_servos(part) for part in PRESETS.get(self.servos, self.servos).split(";")]

    @property
    def wrong(self) -> tuple[ServoDefects, ...]:
        """What `defects` says."""
        return read_defects(ServoDefects, self.defects)


_BOUNDS: Final = (
    ("baud", 9600, 4_500_000),
    ("return_delay", 0, 254),
    ("adapter_latency", 0.0, 255.0),
    ("speed", 0.01, 100.0),
    ("control_port", 0, 65535),
    ("tcp_port", 0, 65535),
    ("trace_size", 1, 1_000_000),
)


def parse_servos(text: str) -> list[ServoSpec]:
    """Read the servos of one bus.

    Raises:
        ConfigError: for what cannot be read, unknown models and ids used twice.
    """
    specs: list[ServoSpec] = []
    for part in text.split(","):
        match = _SERVO.fullmatch(part.strip())
        if match is None:
            hint = f"; or {unknown('preset', part.strip(), PRESETS)}" if ":" not in text else ""
            raise ConfigError(
                f"servos: {part.strip()!r} is not ID:MODEL[@FIRMWARE][~GRAVITY][&ID]{hint}"
            )
        specs.append(_spec(match, specs))
    return specs


def _spec(match: re.Match[str], earlier: Sequence[ServoSpec]) -> ServoSpec:
    number, name = int(match["number"]), match["model"].lower()
    if name not in MODELS:
        raise ConfigError(f"servos: {unknown('model', name, MODELS)}")
    model = MODELS[name]
    firmware = int(match["firmware"] or model.newest_firmware)
    partner = None if match["partner"] is None else int(match["partner"])
    numbers = [spec.number for spec in earlier]
    if number > 252:
        raise ConfigError(f"servos: ids lie in [0, 252], not {number}")
    if firmware > 255:
        raise ConfigError(f"servos: a firmware is at most 255, not {firmware}")
    if number in numbers:
        raise ConfigError(f"servos: id {number} is used twice on a bus")
    if partner is not None and partner not in numbers:
        raise ConfigError(f"servos: {number}&{partner} needs servo {partner} before it")
    if partner is not None and model.protocol == 1:
        raise ConfigError(f"servos: a {name} cannot be a shadow")
    return ServoSpec(number, model, firmware, float(match["gravity"] or 0.0), partner)
