"""What is read of servos: their motion in each cycle, and their health now and then."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_driver_dynamixel.control_tables import EFFORT, POSITION, VELOCITY
from crtk_driver_dynamixel.models import HARDWARE_ERRORS, hardware_error_text
from crtk_driver_dynamixel.servo_state import Values
from crtk_driver_dynamixel.units import Counts
from crtk_drivers.samples import Stamp

MEASURED: Final[Mapping[str, Sequence[str]]] = {
    "position": POSITION,
    "velocity": VELOCITY,
    "effort": EFFORT,
}
"""What is read in each cycle, and the names that models have for it."""

SLOW: Final[Sequence[dict[str, Sequence[str]]]] = (
    {
        "torque": ("torque_enable",),
        "return_level": ("status_return_level",),
        "hardware_error": ("hardware_error_status",),
    },
    {"watchdog": ("bus_watchdog",)},
    {
        "voltage": ("present_input_voltage", "present_voltage"),
        "temperature": ("present_temperature",),
    },
    {name: (name,) for name in ("goal_pwm", "goal_current", "goal_velocity", "goal_position")},
)
"""What is read now and then, one group at a time; of each what a model has."""

HEALTH: Final[Mapping[str, Sequence[str]]] = SLOW[0] | SLOW[1]
"""What says whether a servo can be relied on."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What one cycle read. Arrays are (servos,), in counts; of a servo that did not answer the last known.

    Attributes:
        stamp: half way between request and last reply.
        position, velocity, effort: effort is current or load, whatever the model has.
        seen: monotonic seconds at which each servo answered last; -inf: never.
        valid: it answered this time.
    """

    stamp: Stamp
    position: Counts
    velocity: Counts
    effort: Counts
    seen: NDArray[np.float64]
    valid: NDArray[np.bool_]

    def take_back(self, place: int, before: Frame) -> None:
        """Have a servo count as one that did not answer since the frame before."""
        for now, last in (
            (self.position, before.position),
            (self.velocity, before.velocity),
            (self.effort, before.effort),
            (self.seen, before.seen),
        ):
            now[place] = last[place]
        self.valid[place] = False


class Silences:
    """How long servos have left unanswered what they were asked.

    While a driver is held up it asks nothing: that is no silence of theirs, however long ago they answered.

    Args:
        count: of servos.
    """

    def __init__(self, count: int) -> None:
        self._since = np.full(count, math.inf)
        self._until = np.full(count, -math.inf)

    @property
    def lasting(self) -> NDArray[np.float64]:
        """Seconds (servos,) from the first request that each left unanswered to the end of the wait for the
        last one; -inf: it answered.
        """
        lasting: NDArray[np.float64] = self._until - self._since
        return lasting

    def broken(self, places: NDArray[np.bool_]) -> None:
        """These servos (servos,) have answered."""
        self._since[places] = math.inf

    def go_on(self, places: NDArray[np.int64], began: float, ended: float) -> None:
        """Servos were asked in vain: their places, monotonic seconds of the request and of the wait's end."""
        self._since[places] = np.minimum(self._since[places], began)
        self._until[places] = ended


@dataclass(slots=True)
class Health:
    """What is known of one servo besides its motion.

    Attributes:
        protocol: of its model: 1 if a status is all that tells its errors.
        errors: what the bits of `hardware_error` mean.
        hardware_error: bits of Hardware Error Status (70); of every status in protocol 1.0.
        torque: whether Torque Enable (64) is on; None if not known.
        watchdog: what Bus Watchdog (98) holds: -1, it has stopped the servo; None if not known.
        return_level: Status Return Level (68); None if not known.
        goals: what its goal registers hold, by name.
        goals_read: times that these were read.
        hottest: degrees Celsius at which it stops; NaN if not known.
        voltage: V; NaN if not known.
        temperature: degrees Celsius; NaN if not known.
    """

    protocol: int = 2
    errors: Mapping[int, str] = field(default_factory=lambda: HARDWARE_ERRORS)
    hardware_error: int = 0
    torque: bool | None = None
    watchdog: int | None = None
    return_level: int | None = None
    voltage: float = math.nan
    temperature: float = math.nan
    hottest: float = math.nan
    goals: dict[str, int] = field(default_factory=dict)
    goals_read: int = 0

    @property
    def tripped(self) -> bool:
        """Whether the bus watchdog has stopped it."""
        return self.watchdog is not None and self.watchdog < 0

    @property
    def error_text(self) -> str:
        """The hardware errors in words; empty if there are none."""
        return hardware_error_text(self.hardware_error, self.errors)

    def take(self, values: Values, status_bits: int) -> None:
        """Take what was read.

        Args:
            values: by the roles of `SLOW`.
            status_bits: hardware error that came with the status, in protocol 1.0.
        """
        if self.protocol == 1:
            self.hardware_error = status_bits
        if "torque" in values:
            self.torque = bool(values["torque"])
        if "hardware_error" in values:
            self.hardware_error = values["hardware_error"]
        self.watchdog = values.get("watchdog", self.watchdog)
        self.return_level = values.get("return_level", self.return_level)
        if "goal_position" in values:
            self.goals = {name: value for name, value in values.items() if name.startswith("goal_")}
            self.goals_read += 1
        if "voltage" in values:
            self.voltage = 0.1 * values["voltage"]
        if "temperature" in values:
            self.temperature = float(values["temperature"])
