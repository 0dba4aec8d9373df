"""The payload of an arm follows what its gripper holds, where a user asks for it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Final

from crtk_drivers.config.attached import GripLoadConfig, LoadConfig
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, ConfigError, Reason, WrongReading
from crtk_drivers.geometry.quaternions import pose_from_rotvec
from crtk_drivers.samples import Flag, Numbers, Value, vector

__all__ = ["GripLoad"]

HOLDS: Final = "holds"
"""The reading of a gripper that tells it."""
PAYLOAD: Final = "payload"
TCP: Final = "tcp"
"""Inputs of an arm that take it: mass and centre of gravity, and a pose."""

logger = logging.getLogger(__name__)


class GripLoad:
    """Tells one arm, whenever both rest, what its gripper has begun or ceased to hold; and after it was away.

    Args:
        arm: that is told.
        gripper: behind it.
        config: what it then carries.

    Raises:
        ConfigError: the arm takes no payload, or the gripper does not tell whether it holds something.
    """

    def __init__(self, arm: Engine, gripper: Engine, config: GripLoadConfig) -> None:
        self._arm = arm
        self._gripper = gripper
        self._inputs = {False: _inputs(config.empty), True: _inputs(config.holding)}
        self._told: bool | None = None
        missing = sorted(self._inputs[True].keys() - arm.inputs.keys())
        if missing or HOLDS not in gripper.readings:
            raise ConfigError(
                f"payload_of_grip: {arm.name} takes no {missing[0]}"
                if missing
                else f"payload_of_grip: {gripper.name} does not tell whether it holds something",
                where=gripper.name,
                remedy="Leave it out.",
            )

    def look(self) -> None:
        """Tell the arm, if there is something to be told and both rest; called every now and then."""
        if not self._arm.connected:
            self._told = None  # what it was told it may have lost with its power
            return
        if not self._gripper.is_at_rest:
            return  # between two grips it holds nothing for a moment
        try:
            told = self._gripper.readings[HOLDS].tell()
        except WrongReading:  # it has been logged
            return
        if not isinstance(told, Flag) or told.value is self._told or not self._arm.is_at_rest:
            return
        try:
            for name, value in self._inputs[told.value].items():
                self._arm.give(name, value)
        except CommandRefused as refusal:
            if refusal.reason is Reason.INVALID_TRANSITION:
                return  # a motion has begun meanwhile: later
            logger.error("%s: its payload does not follow the grip: %s", self._arm.where, refusal)
        self._told = told.value


def _inputs(load: LoadConfig) -> Mapping[str, Value]:
    given: dict[str, Value] = {PAYLOAD: Numbers((load.mass, *load.center_of_gravity))}
    if load.tcp is not None:
        given[TCP] = pose_from_rotvec(vector(load.tcp))
    return given
