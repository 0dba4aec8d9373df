"""The limits of the safety configuration, and what their violation is called."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from crtk_sim_backends.ur.motion.kinematics import Floats, norm

_COLLISION: Final = 157
_COLLISION_WITHOUT_PAYLOAD: Final = 158
"""Error codes of a force beyond its limit; their argument is the joint that feels most of it."""

SINGULARITY: Final = 154
"""Error code of what joints cannot follow."""

VIOLATION: Final = 191
TOOL_SPEED: Final = 3
POWER: Final = 6
MOMENTUM: Final = 12
JOINT_SPEED: Final = 32
"""Error code of a violated limit, and its arguments; that of a joint's speed plus its index."""


def collision_code(payload: float) -> int:
    """Return the code of the error log for a collision: one for a payload of 0 kg names that."""
    return _COLLISION if payload else _COLLISION_WITHOUT_PAYLOAD


@dataclass(frozen=True)
class SafetyLimits:
    """What the arm may do at most.

    Speed and force are by default those of the least restricted safety preset of an e-Series; power
    and momentum are such that no move exceeds them, even of the largest arm.

    Attributes:
        tool_speed: of the TCP, m/s.
        tool_force: on the TCP, N.
        power: that the joints give and take, W.
        momentum: of what moves, kg m/s.
    """

    tool_speed: float = 5.0
    tool_force: float = 250.0
    power: float = 6000.0
    momentum: float = 100.0

    def violation(self, outputs: Mapping[str, Any], torque: Floats) -> tuple[int, int] | None:
        """Error code and argument for the first limit that the arm violates, None for none.

        `torque` is what each joint can give at most, N.m.
        """
        if outputs["tcp_force_scalar"] > self.tool_force:
            load = [
                abs(actual - target) / limit
                for actual, target, limit in zip(
                    outputs["actual_current_as_torque"],
                    outputs["target_moment"],
                    torque,
                    strict=True,
                )
            ]
            return collision_code(outputs["payload"]), load.index(max(load))
        if not any(outputs["actual_qd"]):
            return None
        argument = self._violated(outputs, torque)
        return None if argument is None else (VIOLATION, argument)

    def _violated(self, outputs: Mapping[str, Any], torque: Floats) -> int | None:
        """Argument of error code 191 for the first limit that the moving arm violates."""
        if norm(outputs["actual_TCP_speed"][:3]) > self.tool_speed:
            return TOOL_SPEED
        if outputs["actual_momentum"] > self.momentum:
            return MOMENTUM
        power = 0.0
        for moment, limit, speed in zip(
            outputs["actual_current_as_torque"], torque, outputs["actual_qd"], strict=True
        ):
            power += min(abs(moment), limit) * abs(speed)
        return POWER if power > self.power else None
