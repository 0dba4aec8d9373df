"""Kinematics for a device that has joints and no kinematics of its own, from a URDF or a DH table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from typing_extensions import override

from crtk_drivers.config import KinematicsConfig
from crtk_drivers.device import Capabilities, CartesianLimits, Device, Kinematics
from crtk_drivers.errors import ConfigError
from crtk_drivers.kinematics.chain import Chain, DHConvention, DHJoint, JointKind, chain_from_dh
from crtk_drivers.kinematics.serial import SerialChain
from crtk_drivers.samples import JointState, Sample, Twist, Value, vector
from crtk_drivers.wrappers.forwarding import WrappedDevice
from crtk_drivers.wrappers.urdf_file import read_urdf


class ModelledDevice(WrappedDevice):
    """A device with the kinematics of a model: measured_cp and _cv, Cartesian commands, queries.

    Args:
        inner: has joints, and neither kinematics nor poses of its own.
        config: which model, tool and limits.

    Raises:
        ConfigError: it has kinematics, or the model does not fit its joints.
        MissingExtra: pinocchio is not installed.
    """

    def __init__(self, inner: Device, config: KinematicsConfig) -> None:
        super().__init__(inner)
        own = inner.capabilities
        if inner.kinematics is not None:
            raise ConfigError(
                "this device has kinematics of its own",
                where="kinematics",
                remedy="Leave the table out; see the driver's own keys for its tool.",
            )
        if not own.joints:
            raise ConfigError("this device has no joints", where="kinematics")
        tool = config.tool
        self._chain = SerialChain(
            _chain(config, own),
            tool=None if tool is None else tool.pose,
            frame_id=own.base_frame,
            name=inner.address,
            position_only=config.position_only,
        )
        limits = config.limits
        self._capabilities = replace(
            own,
            cartesian_limits=CartesianLimits(
                limits.linear_velocity,
                limits.angular_velocity,
                limits.linear_acceleration,
                limits.angular_acceleration,
                limits.force,
                limits.torque,
            ),
            measured=(*own.measured, "measured_cp", "measured_cv"),
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def kinematics(self) -> Kinematics:
        return self._chain

    @override
    def read(self, deadline: float) -> Sample | None:
        """Add the tool to what was read; the stamp is the same."""
        sample = self.inner.read(deadline)
        state = None if sample is None else sample.values.get("measured_js")
        if sample is None or not isinstance(state, JointState) or not state.position.size:
            return sample
        if sample.not_finite:
            return sample  # the core drops it
        values: dict[str, Value] = dict(sample.values)
        values["measured_cp"] = self._chain.forward(state.position)
        if state.velocity.size:
            twist = vector(self._chain.jacobian(state.position) @ state.velocity)
            values["measured_cv"] = Twist(twist[:3], twist[3:], self._capabilities.base_frame)
        return replace(sample, values=values)


def _chain(config: KinematicsConfig, own: Capabilities) -> Chain:
    """Return the model with the names and ranges that the device gives its joints."""
    if config.urdf is None:
        if len(config.dh) != len(own.joints):
            raise ConfigError(
                f"{len(config.dh)} rows for {len(own.joints)} joints",
                where="kinematics.dh",
                remedy="Give one row for each joint, in the order of the device.",
            )
        rows = [
            DHJoint(name, row.a, row.alpha, row.d, row.theta, JointKind(row.kind))
            for name, row in zip(own.joints, config.dh, strict=True)
        ]
        chain = chain_from_dh(rows, DHConvention(config.dh_convention))
        names = own.joints
    else:
        names = config.joints or own.joints
        if len(names) != len(own.joints):
            raise ConfigError(
                f"{len(names)} names for {len(own.joints)} joints",
                where="kinematics.joints",
                remedy="Name the joints of the URDF in the order of the device.",
            )
        path = Path(config.urdf).expanduser()
        chain = read_urdf(path, base=config.base_link, tip=config.tip_link, joints=names)
    device = {
        name: (joint, limit)
        for name, joint, limit in zip(names, own.joints, own.limits, strict=True)
    }
    joints = []
    for joint in chain.joints:
        name, limit = device[joint.name]
        joints.append(replace(joint, name=name, lower=limit.lower, upper=limit.upper))
    return replace(chain, joints=tuple(joints), names=own.joints)
