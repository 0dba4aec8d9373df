"""A device that may go nowhere but where its user allows it to, and no faster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from typing_extensions import override

from crtk_drivers.device import Capabilities, CartesianLimits, Device, Goal, JointLimits
from crtk_drivers.errors import ConfigError
from crtk_drivers.wrappers.forwarding import WrappedDevice


class Range(Protocol):
    """From where to where, in rad (m)."""

    @property
    def lower(self) -> float:
        """Least value."""

    @property
    def upper(self) -> float:
        """Greatest value."""


class ConfinedDevice(WrappedDevice):
    """Declares narrower limits than the device has; the gates of the core refuse what is beyond them.

    Args:
        inner: the device.
        joints: ranges, one for each joint, or none.
        speed: share of every velocity limit, above 0 and at most 1.

    Raises:
        ConfigError: not one range a joint, or one that lies outside of what the joint can do.
    """

    def __init__(self, inner: Device, joints: Sequence[Range], speed: float) -> None:
        super().__init__(inner)
        own = inner.capabilities
        if joints and len(joints) != len(own.joints):
            raise ConfigError(
                f"space.joints: {len(joints)} ranges for {len(own.joints)} joints",
                where=inner.address,
                remedy=f"Give one for each of: {', '.join(own.joints) or 'no joints'}.",
            )
        ranges = joints or own.limits
        tool = own.cartesian_limits
        self._capabilities = replace(
            own,
            limits=tuple(
                _narrowed(name, limits, allowed, speed)
                for name, limits, allowed in zip(own.joints, own.limits, ranges, strict=True)
            ),
            move_limits=tuple(
                replace(limits, velocity=min(limits.velocity, speed * full.velocity))
                for limits, full in zip(own.move_limits, own.limits, strict=False)
            ),
            cartesian_limits=None if tool is None else _slowed(tool, tool, speed),
            line_limits=None
            if own.line_limits is None
            else _slowed(own.line_limits, tool or own.line_limits, speed),
        )

        self._speed = speed

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @override
    def move(self, goal: Goal) -> None:
        ratios = replace(goal.ratios, velocity=self._speed * goal.ratios.velocity)
        self.inner.move(replace(goal, ratios=ratios))


def _narrowed(name: str, limits: JointLimits, allowed: Range, speed: float) -> JointLimits:
    lower, upper = max(limits.lower, allowed.lower), min(limits.upper, allowed.upper)
    if not lower < upper:
        raise ConfigError(
            f"space.joints: {name} cannot be within {allowed.lower:g} to {allowed.upper:g}",
            remedy=f"Its own range is {limits.lower:g} to {limits.upper:g}.",
        )
    return replace(limits, lower=lower, upper=upper, velocity=speed * limits.velocity)


def _slowed(limits: CartesianLimits, full: CartesianLimits, speed: float) -> CartesianLimits:
    return replace(
        limits,
        linear_velocity=min(limits.linear_velocity, speed * full.linear_velocity),
        angular_velocity=min(limits.angular_velocity, speed * full.angular_velocity),
    )
