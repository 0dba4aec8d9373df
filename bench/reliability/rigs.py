"""All drivers of the table."""

from __future__ import annotations

from bench.reliability.rig import Rig
from bench.reliability.rig_canopen import CanopenRig
from bench.reliability.rig_dynamixel import DynamixelRig
from bench.reliability.rig_memory import LoopbackRig, VirtualRig
from bench.reliability.rig_ndi import NdiRig
from bench.reliability.rig_netft import NetFtRig
from bench.reliability.rig_ur import UrNativeRig, UrRtdeRig

RIGS: dict[str, type[Rig]] = {
    rig.name: rig
    for rig in (
        UrNativeRig,
        UrRtdeRig,
        DynamixelRig,
        CanopenRig,
        NetFtRig,
        NdiRig,
        VirtualRig,
        LoopbackRig,
    )
}
"""By name."""
