"""Users who do all that a device offers, and judges of what was promised.

subject         a device with joints under test: its driver, its simulator, and their truth
user            what its users do; acting, operations, streaming: in which ways
far_user        what its users do on the far side of ROS 2
judges          what it promises, judged by its simulator's truth
instrument      a device that measures; instrument_user, instrument_judges: the same for it
pusher          the same for a haptic device, which is pushed
"""
