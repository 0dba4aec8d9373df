"""What the units of a joint are reckoned from, as protocols of its configuration."""

from __future__ import annotations

from typing import Protocol


class JointScale(Protocol):
    """What the configuration of a joint says of its units; see `crtk_driver_canopen.joint_scales`."""

    @property
    def kind(self) -> str: ...  # noqa: D102
    @property
    def scale(self) -> float | None: ...  # noqa: D102
    @property
    def velocity_scale(self) -> float | None: ...  # noqa: D102
    @property
    def measured_velocity_scale(self) -> float | None: ...  # noqa: D102
    @property
    def acceleration_scale(self) -> float | None: ...  # noqa: D102
    @property
    def ramp_time_scale(self) -> float | None: ...  # noqa: D102
    @property
    def counts_per_turn(self) -> float | None: ...  # noqa: D102
    @property
    def gear(self) -> float | None: ...  # noqa: D102
    @property
    def feed(self) -> float | None: ...  # noqa: D102
    @property
    def sign(self) -> int: ...  # noqa: D102
    @property
    def offset(self) -> float: ...  # noqa: D102
    @property
    def rated_torque(self) -> float | None: ...  # noqa: D102
    @property
    def effort_scale(self) -> float | None: ...  # noqa: D102
    @property
    def measured_effort_scale(self) -> float | None: ...  # noqa: D102


class JointRange(JointScale, Protocol):
    """What the configuration of a joint says of what it is sent."""

    @property
    def lower(self) -> float: ...  # noqa: D102
    @property
    def upper(self) -> float: ...  # noqa: D102
    @property
    def velocity(self) -> float: ...  # noqa: D102
    @property
    def effort(self) -> float: ...  # noqa: D102
