"""From what a sensor measures to the load that is meant: bias, weight of the tool, point and axes.

Everything here is linear and works on blocks of wrenches (n, 6), force in N before torque in N·m. Rotation
matrices hold the axes of the inner frame in the outer one as columns.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from crtk_drivers.samples import Array, Vector, vector

GRAVITY = vector((0.0, 0.0, -9.80665))
"""Acceleration of free fall in a world whose z axis points up, in m/s²."""

NO_LOAD = vector(np.zeros(6))
UNKNOWN_LOAD = vector(np.full(6, np.nan))
"""Taken off from anything it leaves nothing that could be mistaken for a measurement."""


@dataclass(frozen=True, eq=False)
class Tool:
    """What hangs on the sensor: mass in kg and centre of mass (3,) in the sensor's frame, in m."""

    mass: float
    center: Vector

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", vector(self.center))
        if not 0.0 <= self.mass < np.inf or self.center.shape != (3,):
            raise ValueError(f"no tool: {self.mass} kg at {self.center}")

    def weight(self, rotation: Array, gravity: Vector = GRAVITY) -> Vector:
        """Return the wrench (6,) of the tool's weight on the sensor, in the sensor's axes.

        Args:
            rotation: of the sensor in the world (3, 3).
            gravity: in the world (3,), m/s².
        """
        force = self.mass * (rotation.T @ gravity)
        return vector(np.concatenate((force, np.cross(self.center, force))))


def transfer(point: Vector, rotation: Array) -> Array:
    """Return the matrix (6, 6) that gives a wrench about another point, in other axes.

    Args:
        point: the other frame's origin in the sensor's frame (3,), in m.
        rotation: of the other frame in the sensor's (3, 3).
    """
    x, y, z = point.tolist()
    lever = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = rotation.T
    matrix[3:, :3] = -rotation.T @ lever
    return matrix


@dataclass(frozen=True, eq=False)
class Compensation:
    """What is taken off each measurement, and where the rest is stated.

    Attributes:
        bias: software bias (6,), in the sensor's frame.
        weight: of the tool at its present orientation (6,), in the sensor's frame; `UNKNOWN_LOAD` if that
            orientation is not known.
        matrix: see `transfer`.
    """

    bias: Vector = field(default_factory=lambda: NO_LOAD)
    weight: Vector = field(default_factory=lambda: NO_LOAD)
    matrix: Array = field(default_factory=lambda: np.eye(6))
    _offset: Vector = field(init=False)
    _is_known: bool = field(init=False)
    _changes: bool = field(init=False)

    def __post_init__(self) -> None:
        offset = self.matrix @ (self.bias + self.weight)
        object.__setattr__(self, "_offset", offset)
        object.__setattr__(self, "_is_known", bool(np.isfinite(offset).all()))
        changes = offset.any() or not np.array_equal(self.matrix, np.eye(6))
        object.__setattr__(self, "_changes", bool(changes))

    @property
    def is_known(self) -> bool:
        """Whether there is something to take off."""
        return self._is_known

    def apply(self, values: Array) -> Array:
        """Return wrenches (n, 6) or (6,) without bias and weight, at the point and in the axes wanted.

        All of it is not a number while the weight is not known. Where nothing is to be done it is `values`.
        """
        if not self._changes:
            return values
        result: Array = values @ self.matrix.T - self._offset
        return result


@dataclass(frozen=True, eq=False)
class ToolFit:
    """A tool as found from measurements in several poses.

    Attributes:
        tool: mass and centre of mass.
        bias: of the sensor (6,): what it would measure without the tool's weight.
        residuals: what is left of each measurement (n, 6), in N and N·m.
        mass_error: standard error of the mass, in kg.
        center_error: of the centre of mass (3,), in m.
    """

    tool: Tool
    bias: Vector
    residuals: Array
    mass_error: float
    center_error: Vector

    @property
    def force_residual(self) -> float:
        """Root mean square of what is left of the force vector, in N."""
        return float(np.sqrt((self.residuals[:, :3] ** 2).sum(axis=1).mean()))

    @property
    def torque_residual(self) -> float:
        """The same of the torque vector, in N·m."""
        return float(np.sqrt((self.residuals[:, 3:] ** 2).sum(axis=1).mean()))

    @property
    def summary(self) -> str:
        """Mass and residuals, for people."""
        return (
            f"{self.tool.mass:.4f} kg, {self.force_residual:.3g} N, {self.torque_residual:.3g} N·m"
        )


LEAST_SPREAD = 0.2
"""Of the directions of gravity in the sensor's frame, across the line that fits them best; at most 0.7."""


def spread(rotations: Array, gravity: Vector = GRAVITY) -> float:
    """Return how well poses are spread for `fit_tool`: see `LEAST_SPREAD`.

    Args:
        rotations: of the sensor in the world (n, 3, 3).
        gravity: in the world (3,).
    """
    directions = np.einsum("nji,j->ni", rotations, gravity / np.linalg.norm(gravity))
    centered = directions - directions.mean(axis=0)
    singular = np.linalg.svd(centered / np.sqrt(len(centered)), compute_uv=False)
    return float(singular[1]) if singular.size > 1 else 0.0


def fit_tool(wrenches: Array, rotations: Array, gravity: Vector = GRAVITY) -> ToolFit:
    """Return the tool and the bias that explain the measurements best, by least squares.

    The model is F = m·Rᵀg + b_F and T = c × (m·Rᵀg) + b_T.

    Args:
        wrenches: measured at rest, averaged, without software bias (n, 6).
        rotations: of the sensor in the world (n, 3, 3).
        gravity: in the world (3,), m/s².

    Raises:
        ValueError: fewer than three poses, not enough spread, not finite, or no positive mass comes out.
    """
    count = len(wrenches)
    if wrenches.shape != (count, 6) or rotations.shape != (count, 3, 3):
        raise ValueError(f"{wrenches.shape} wrenches for {rotations.shape} rotations")
    if not (np.isfinite(wrenches).all() and np.isfinite(rotations).all()):
        raise ValueError("a measurement or an orientation is not finite")
    if count < 3:
        raise ValueError(f"{count} poses are too few: take three at the least, better six")
    reached = spread(rotations, gravity)
    if reached < LEAST_SPREAD:
        raise ValueError(
            f"the poses are too much alike (spread {reached:.2f}, needed {LEAST_SPREAD}): "
            "turn the sensor so that gravity pulls along each of its axes"
        )
    pulls = np.einsum("nji,j->ni", rotations, gravity)
    identity = np.tile(np.eye(3), (count, 1))
    on_force = np.hstack((pulls.reshape(-1, 1), identity))
    force, force_covariance = _solve(on_force, wrenches[:, :3].reshape(-1))
    # T = (m c) × g + b: the product of mass and centre enters linearly
    crossed = np.concatenate([_crossed_with(pull) for pull in pulls])
    torque, torque_covariance = _solve(np.hstack((crossed, identity)), wrenches[:, 3:].reshape(-1))
    mass = float(force[0])
    if not mass > 0.0:
        raise ValueError(
            f"a mass of {mass:.3g} kg comes out: is there a tool, and are the orientations right?"
        )
    tool = Tool(mass, vector(torque[:3] / mass))
    bias = vector(np.concatenate((force[1:], torque[3:])))
    model = np.array([tool.weight(rotation, gravity) for rotation in rotations]) + bias
    return ToolFit(
        tool,
        bias,
        wrenches - model,
        float(np.sqrt(force_covariance[0, 0])),
        vector(np.sqrt(np.diag(torque_covariance)[:3]) / mass),
    )


def _solve(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Return the solution by least squares and its covariance."""
    solution = np.linalg.lstsq(matrix, right, rcond=None)[0].astype(np.float64)
    left = right - matrix @ solution
    freedom = max(1, len(right) - len(solution))
    inverse = np.linalg.inv(matrix.T @ matrix).astype(np.float64)
    return solution, inverse * (float(left @ left) / freedom)


def _crossed_with(pull: Vector) -> Array:
    """Return the matrix (3, 3) that gives v × pull for a v."""
    x, y, z = pull.tolist()
    return np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))
