"""The mechanics of one robot: its arm, what hangs on it, and what it feels."""

from __future__ import annotations

from crtk_sim_backends.ur.models import RobotModel
from crtk_sim_backends.ur.motion.arm import Arm, LimitViolation
from crtk_sim_backends.ur.motion.calibration import kinematics_of
from crtk_sim_backends.ur.motion.compliance import Compliance
from crtk_sim_backends.ur.motion.dynamics import Dynamics
from crtk_sim_backends.ur.motion.force_sensor import ForceSensor
from crtk_sim_backends.ur.motion.kinematics import IDENTITY, Floats, Matrix, to_transform
from crtk_sim_backends.ur.motion.superposition import Superposition


class Plant:
    """The arm with its tool and load.

    Args:
        model: of the arm.
        dt: control period, s.

    Attributes:
        tcp: pose in the flange frame; `tool` is the same as a transform.
        payload: kg.
        payload_cog: its centre of gravity, m, flange frame.
        payload_inertia: kg m^2 (Ixx Iyy Izz Ixy Ixz Iyz).
        gravity: upward acceleration that the base feels, m/s^2.
        load_revision: counts the changes of tool, load and forces.
    """

    def __init__(self, model: RobotModel, dt: float) -> None:
        self.arm = Arm(model, dt)
        self.kinematics = kinematics_of(model)
        self.dynamics = Dynamics(self.kinematics)
        self.compliance = Compliance(self.arm, self.kinematics)
        self.superposition = Superposition(self.arm, self.kinematics)
        self.force_sensor = ForceSensor()
        self.tool = IDENTITY
        self.tcp: tuple[float, ...] = (0.0,) * 6
        self.payload = 0.0
        self.payload_cog: tuple[float, ...] = (0.0,) * 3
        self.payload_inertia: tuple[float, ...] = (0.0,) * 6
        self.gravity: tuple[float, ...] = (0.0, 0.0, 9.82)
        self.load_revision = 0

    @property
    def coasts(self) -> bool:
        """Whether the arm still moves beside its plan, from a mode that has been left."""
        return self.compliance.coasts or self.superposition.coasts

    def end_modes(self) -> None:
        """Leave every mode in which the arm moves beside its plan."""
        self.compliance.end()
        self.superposition.end(self.arm.stop_deceleration)

    def leave_plan(self, pace: float) -> LimitViolation | None:
        """Move beside the plan for one control period, in the modes that do.

        What is added to the path goes before what gives way to forces, which then does not. `pace` is 0
        while the program is paused, 1 else. Returns what the modes violate.
        """
        superposition, sensor = self.superposition, self.force_sensor
        if superposition.source is not None or superposition.coasts:
            return superposition.step(self.tool, pace)
        measured = sensor.use_external or self.compliance.force_task is not None
        self.compliance.step(sensor.tcp if measured else sensor.applied, self.tool)
        return None

    def set_tcp(self, pose: tuple[float, ...]) -> None:
        """Set the TCP: a pose in the flange frame."""
        self.tcp = pose
        self.tool = to_transform(pose) if any(pose) else IDENTITY
        self.load_changed()

    def set_payload(self, mass: float, cog: tuple[float, ...], inertia: tuple[float, ...]) -> None:
        """Set the payload: kg, m (flange frame) and kg m^2 (Ixx Iyy Izz Ixy Ixz Iyz)."""
        self.payload, self.payload_cog, self.payload_inertia = mass, cog, inertia
        self.load_changed()

    def set_gravity(self, gravity: tuple[float, ...]) -> None:
        """Set the upward acceleration that the base feels, m/s^2."""
        self.gravity = gravity
        self.load_changed()

    def load_changed(self) -> None:
        """Have outputs that depend on tool, load and forces computed again."""
        self.load_revision += 1

    def mass_matrix(self, q: Floats, rotors: bool = True) -> Matrix:
        """Mass matrix with the present payload, kg m^2."""
        return self.dynamics.mass_matrix(
            q, self.payload, self.payload_cog, self.payload_inertia, rotors
        )

    def coriolis(self, q: Floats, qd: Floats) -> list[float]:
        """Coriolis and centrifugal torques with the present payload, N.m."""
        return self.dynamics.coriolis(q, qd, self.payload, self.payload_cog, self.payload_inertia)
