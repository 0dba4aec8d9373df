"""The force and torque sensor in the tool flange."""

from __future__ import annotations

from crtk_sim_backends.ur.motion.kinematics import Floats, Transform, cross, rotate, rotate_back

ZERO: tuple[float, ...] = (0.0,) * 6


class ForceSensor:
    """Measures the wrench on the tool, from the plant or from an RTDE input.

    Attributes:
        applied: wrench that the surroundings exert on the tool at the TCP, base axes, N and N.m.
        external: the measurement of an external sensor at the flange, flange axes.
        use_external: take `external` instead of the built-in measurement
            (`ft_rtde_input_enable`).
        raw: last measurement at the flange, flange axes, weight of the payload included.
        tcp: last wrench at the TCP, base axes, weight of the payload removed.
    """

    def __init__(self) -> None:
        self.applied: tuple[float, ...] = ZERO
        self.external: tuple[float, ...] = ZERO
        self.use_external = False
        self.raw: tuple[float, ...] = ZERO
        self.tcp: tuple[float, ...] = ZERO
        self._measured: tuple[float, ...] = ZERO  # at the flange, weight removed
        self._offset: tuple[float, ...] = ZERO

    def zero(self) -> None:
        """Take the present wrench as zero (`zero_ftsensor`)."""
        self._offset = self._measured

    def _loaded(self) -> bool:
        return self.use_external or any(self.applied) or any(self._offset)

    def measure(
        self, flange: Transform, tool: Transform, payload: float, cog: Floats, gravity: Floats
    ) -> None:
        """Measure with the flange at `flange`; `payload` kg with centre `cog`, m, hangs on it."""
        if not payload and not self._loaded():
            self.raw = self.tcp = self._measured = ZERO
            return
        lever = tool[9:]
        weight = rotate_back(flange, [-payload * g for g in gravity])
        weight_torque = cross(cog, weight)
        if self.use_external:
            self._measured = self.external
        else:
            force = rotate_back(flange, self.applied[:3])
            torque = rotate_back(flange, self.applied[3:])
            moment = cross(lever, force)
            self._measured = (*force, *(t + m for t, m in zip(torque, moment, strict=True)))
        load = (*weight, *weight_torque)
        self.raw = tuple(m + w for m, w in zip(self._measured, load, strict=True))
        net = [m - o for m, o in zip(self._measured, self._offset, strict=True)]
        moment = cross(lever, net[:3])
        self.tcp = (
            *rotate(flange, net[:3]),
            *rotate(flange, [t - m for t, m in zip(net[3:], moment, strict=True)]),
        )
