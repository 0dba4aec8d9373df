"""A leader moves a follower: what of that is numbers and states, without ROS, threads and clocks.

`teleop_settings.py` is the table ``[teleop]`` of a lab file, `both_sides.py` what is heard and what is sent,
`coupling.py` the geometry, `jaws.py` a gripper that leads a jaw, and `machine.py` the states: `step` takes
what was heard and returns what to send.
"""

from crtk_drivers.motion.teleop.both_sides import Commands, Heard, Inputs, Side
from crtk_drivers.motion.teleop.machine import Coupled, Phase, step
from crtk_drivers.motion.teleop.teleop_settings import TeleopSettings

__all__ = ["Commands", "Coupled", "Heard", "Inputs", "Phase", "Side", "TeleopSettings", "step"]
