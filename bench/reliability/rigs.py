"""All drivers of the table."""

from __future__ import annotations

from bench.reliability.rig import Rig
from bench.reliability.rig_canopen import CanopenRig
from bench.reliability.rig_copley import CopleyRig
from bench.reliability.rig_dvrk import DrivenDvrkRig, DvrkRig
from bench.reliability.rig_dynamixel import DynamixelRig
from bench.reliability.rig_force_dimension import ForceDimensionRig
from bench.reliability.rig_ft300 import Ft300Rig
from bench.reliability.rig_galil import GalilRig
from bench.reliability.rig_haply import HaplyRig
from bench.reliability.rig_inputs import InputsRig
from bench.reliability.rig_memory import LoopbackRig, VirtualRig
from bench.reliability.rig_ndi import NdiRig
from bench.reliability.rig_netft import NetFtRig
from bench.reliability.rig_openhaptics import OpenHapticsRig
from bench.reliability.rig_optoforce import OptoForceRig
from bench.reliability.rig_raven import RavenRig
from bench.reliability.rig_robotiq import RobotiqRig, RobotiqUrcapRig
from bench.reliability.rig_ros2_control import Ros2ControlRig
from bench.reliability.rig_ur import UrNativeRig, UrRtdeRig

RIGS: dict[str, type[Rig]] = {
    rig.name: rig
    for rig in (
        UrNativeRig,
        UrRtdeRig,
        DynamixelRig,
        CanopenRig,
        CopleyRig,
        GalilRig,
        HaplyRig,
        ForceDimensionRig,
        OpenHapticsRig,
        DvrkRig,
        DrivenDvrkRig,
        NetFtRig,
        NdiRig,
        RobotiqRig,
        RobotiqUrcapRig,
        Ft300Rig,
        OptoForceRig,
        RavenRig,
        InputsRig,
        Ros2ControlRig,
        VirtualRig,
        LoopbackRig,
    )
}
"""By name."""
