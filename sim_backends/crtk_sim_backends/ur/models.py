"""The arms that can be simulated: kinematics, limits and masses, as one table.

Sources: DH parameters, link masses and centres of mass from Universal Robots "DH parameters for
calculations of kinematics and dynamics"; speeds from the user manuals; torques from "Max. joint
torques" (the same numbers as in Universal_Robots_ROS2_Description). Acceleration limits are not
published; 40 rad/s^2 is the largest value that the controller's built-ins accept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, pi, radians
from typing import Final, NamedTuple, TypeAlias

Vector3: TypeAlias = tuple[float, float, float]
Vector6: TypeAlias = tuple[float, float, float, float, float, float]

ALPHA: Final[Vector6] = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)
"""DH link twists, rad; the same for every arm."""


class Calibration(NamedTuple):
    """The lengths, m, and angles, rad, of one arm's own links (Denavit-Hartenberg), and their checksum."""

    theta: Vector6
    a: Vector6
    d: Vector6
    alpha: Vector6
    checksum: tuple[int, ...]


@dataclass(frozen=True)
class RobotModel:
    """One arm.

    Attributes:
        name: key in `MODELS`.
        title: name on the nameplate, which the dashboard reports without the trailing "e".
        frequency: control frequency, Hz.
        robot_type: number of the arm in the primary interface.
        d: DH link offsets, m.
        a: DH link lengths, m.
        velocity: joint speed limits, rad/s.
        torque: joint torque limits, N.m.
        mass: link masses, shoulder to wrist 3, kg.
        cog: centres of mass in the DH frame at the end of each link, m.
        position: joint position limit to both sides, rad.
        acceleration: joint acceleration limit, rad/s^2.
        calibration: of an arm that is not quite as the model says.
        reach: longest distance of the wrist from the shoulder, m (derived).
    """

    name: str
    title: str
    frequency: int
    robot_type: int
    d: Vector6
    a: Vector6
    velocity: Vector6
    torque: Vector6
    mass: Vector6
    cog: tuple[Vector3, Vector3, Vector3, Vector3, Vector3, Vector3]
    position: Vector6 = (2 * pi,) * 6
    acceleration: float = 40.0
    calibration: Calibration | None = None
    safe_position: float = 6.3355451848  # 363 degrees as the controller rounds them

    def limited_to(self, position: float) -> RobotModel:
        """Return the arm with a narrower safety configuration: `position` to both sides, rad."""
        a, b, c, d, e, f = (min(position, largest) for largest in self.position)
        return replace(self, position=(a, b, c, d, e, f), safe_position=position)

    @property
    def reach(self) -> float:
        """Length of the stretched arm from shoulder to wrist, m."""
        return -self.a[1] - self.a[2]

    @property
    def is_cb3(self) -> bool:
        """Whether the arm belongs to the CB3 generation (125 Hz, software 3.x)."""
        return self.frequency == 125


def _arm(
    title: str,
    frequency: int,
    robot_type: int,
    dh: Vector6,
    degrees_per_second: tuple[float, float, float, float],
    torque: tuple[float, float, float, float],
    mass: Vector6,
    cog: tuple[Vector3, Vector3, Vector3, Vector3, Vector3, Vector3],
    unlimited_wrist_3: bool = False,
) -> RobotModel:
    """One table row: `dh` is d1 a2 a3 d4 d5 d6, limits are base, shoulder, elbow and wrists."""
    d1, a2, a3, d4, d5, d6 = dh
    speed = [radians(value) for value in degrees_per_second]
    return RobotModel(
        name=title.lower(),
        title=title,
        frequency=frequency,
        robot_type=robot_type,
        d=(d1, 0.0, 0.0, d4, d5, d6),
        a=(0.0, a2, a3, 0.0, 0.0, 0.0),
        velocity=(speed[0], speed[1], speed[2], speed[3], speed[3], speed[3]),
        torque=(torque[0], torque[1], torque[2], torque[3], torque[3], torque[3]),
        mass=mass,
        cog=cog,
        position=(*(2 * pi,) * 5, inf if unlimited_wrist_3 else 2 * pi),
    )


MODELS: Final[dict[str, RobotModel]] = {
    model.name: model
    for model in (
        _arm(
            "UR3",
            125,
            3,
            (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
            (180, 180, 180, 360),
            (56, 56, 28, 12),
            (2.0, 3.42, 1.26, 0.8, 0.8, 0.35),
            (
                (0, -0.02, 0),
                (0.13, 0, 0.1157),
                (0.05, 0, 0.0238),
                (0, 0, 0.01),
                (0, 0, 0.01),
                (0, 0, -0.02),
            ),
            unlimited_wrist_3=True,
        ),
        _arm(
            "UR5",
            125,
            1,
            (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
            (180, 180, 180, 180),
            (150, 150, 150, 28),
            (3.7, 8.393, 2.33, 1.219, 1.219, 0.1879),
            (
                (0, -0.02561, 0.00193),
                (0.2125, 0, 0.11336),
                (0.15, 0, 0.0265),
                (0, -0.0018, 0.01634),
                (0, 0.0018, 0.01634),
                (0, 0, -0.001159),
            ),
        ),
        _arm(
            "UR10",
            125,
            2,
            (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
            (120, 120, 180, 180),
            (330, 330, 150, 56),
            (7.1, 12.7, 4.27, 2.0, 2.0, 0.365),
            (
                (0.021, 0, 0.027),
                (0.38, 0, 0.158),
                (0.24, 0, 0.068),
                (0, 0.007, 0.018),
                (0, 0.007, 0.018),
                (0, 0, -0.026),
            ),
        ),
        _arm(
            "UR3e",
            500,
            3,
            (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
            (180, 180, 180, 360),
            (54, 54, 28, 9),
            (1.98, 3.4445, 1.437, 0.871, 0.805, 0.261),
            (
                (0, -0.02, 0),
                (0.13, 0, 0.1157),
                (0.05, 0, 0.0238),
                (0, 0, 0.01),
                (0, 0, 0.01),
                (0, 0, -0.02),
            ),
            unlimited_wrist_3=True,
        ),
        _arm(
            "UR5e",
            500,
            1,
            (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
            (180, 180, 180, 180),
            (150, 150, 150, 28),
            (3.761, 8.058, 2.846, 1.37, 1.3, 0.365),
            (
                (0, -0.02561, 0.00193),
                (0.2125, 0, 0.11336),
                (0.15, 0, 0.0265),
                (0, -0.0018, 0.01634),
                (0, 0.0018, 0.01634),
                (0, 0, -0.001159),
            ),
        ),
        _arm(
            "UR10e",
            500,
            2,
            (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
            (120, 120, 180, 180),
            (330, 330, 150, 54),
            (7.369, 13.051, 3.989, 2.1, 1.98, 0.615),
            (
                (0.021, 0, 0.027),
                (0.38, 0, 0.158),
                (0.24, 0, 0.068),
                (0, 0.007, 0.018),
                (0, 0.007, 0.018),
                (0, 0, -0.026),
            ),
        ),
        _arm(
            "UR16e",
            500,
            4,
            (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
            (120, 120, 180, 180),
            (330, 330, 150, 54),
            (7.369, 10.45, 4.321, 2.18, 2.033, 0.907),
            (
                (0, -0.016, 0.03),
                (0.302, 0, 0.16),
                (0.194, 0, 0.065),
                (0, -0.009, 0.011),
                (0, 0.018, 0.012),
                (0, 0, -0.044),
            ),
        ),
        _arm(
            "UR20",
            500,
            7,
            (0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543),
            (120, 120, 150, 210),
            (738, 738, 433, 107),
            (16.343, 29.632, 7.879, 3.054, 3.126, 0.926),
            (
                (0, -0.061, 0.0062),
                (0.5226, 0, 0.2098),
                (0.3234, 0, 0.0604),
                (0, -0.0026, 0.0393),
                (0, 0.0024, 0.0379),
                (0, 0, -0.0293),
            ),
        ),
        _arm(
            "UR30",
            500,
            8,
            (0.2363, -0.637, -0.5037, 0.201, 0.1593, 0.1543),
            (120, 120, 150, 210),
            (730, 730, 430, 100),
            (16.343, 28.542, 7.156, 3.054, 3.126, 0.926),
            (
                (-0.0001, -0.06, 0.0069),
                (0.3894, 0, 0.2103),
                (0.2257, 0, 0.0629),
                (0, -0.0048, 0.0353),
                (0, 0.0046, 0.0341),
                (0, 0, -0.0293),
            ),
        ),
    )
}
"""Every simulated arm, by lower-case name."""
