"""Defects of a simulated UR, for a bench that must find them: what it tells of its joints and its tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from crtk_sim_backends.defects import JointDefects, Sense, defects_of
from crtk_sim_backends.ur.motion.kinematics import Kinematics, Transform, compose, to_pose


@dataclass(frozen=True, kw_only=True)
class ArmDefects(JointDefects):
    """What is wrong with what an arm tells; joints are 1 to 6, from the base.

    Attributes:
        calibration: added to joints where the pose of the tool is computed, and nowhere else, rad.
        pose_scale: factor on the position of the tool; 1000: mm for m. That of the first group counts.
        ignores_watchdog: 1 in any group: programs go on when an RTDE input that they watch stays away.
        ignores_emergency_stop: 1 in any group: the emergency stop on the pendant does nothing.
    """

    calibration: float = 0.0
    pose_scale: float = 1.0
    ignores_watchdog: int = 0
    ignores_emergency_stop: int = 0


class Flaws:
    """Makes of what is true what the arm tells.

    Args:
        groups: of joints with defects, at least one.
        per_current: torque of each joint for its current, N·m/A.
    """

    def __init__(self, groups: Sequence[ArmDefects], per_current: Sequence[float]) -> None:
        self._per_current = per_current
        self._defects = [defects_of(groups, joint) for joint in range(1, 7)]
        self._senses = [
            None if defects is None else Sense(defects, joint)
            for joint, defects in enumerate(self._defects, start=1)
        ]
        self._scale = groups[0].pose_scale

    def tell(
        self,
        out: dict[str, Any],
        q: Sequence[float],
        qd: Sequence[float],
        current: Sequence[float],
        time: float,
    ) -> None:
        """Put what is told of the joints into outputs.

        Args:
            out: outputs by name.
            q: positions, rad.
            qd: velocities, rad/s.
            current: A.
            time: of the controller, s.
        """
        told = [
            (*joint,) if sense is None else sense.tell(*joint, time)
            for sense, joint in zip(self._senses, zip(q, qd, current, strict=True), strict=True)
        ]
        positions, speeds, currents = zip(*told, strict=True)
        out["actual_q"], out["actual_qd"], out["actual_current"] = positions, speeds, currents
        out["actual_current_as_torque"] = tuple(
            [k * i for k, i in zip(self._per_current, currents, strict=True)]
        )

    def tell_pose(self, out: dict[str, Any], kinematics: Kinematics, tool: Transform) -> None:
        """Put the pose of the tool, for the joints that are told, into outputs."""
        q = [
            angle + (0.0 if defects is None else defects.calibration)
            for angle, defects in zip(out["actual_q"], self._defects, strict=True)
        ]
        x, y, z, *turn = to_pose(compose(kinematics.flange(q), tool))
        out["actual_TCP_pose"] = (self._scale * x, self._scale * y, self._scale * z, *turn)
