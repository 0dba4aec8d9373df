"""Rehearse what your program does when the robot stops: press a simulated emergency stop. No ROS.

python examples/survive_a_fault.py
"""

import time

import crtk_drivers

with crtk_drivers.connect("ur", sim=True) as arm:
    assert arm.sim is not None  # there is one because of sim=True
    arm.enable()
    move = arm.move_jp(arm.setpoint_jp() + 0.5)
    arm.sim.control.inject("emergency_stop")

    try:
        move.wait()
    except crtk_drivers.CrtkError as error:
        print("the move:", error)
    print("the arm:", arm.operating_state().detail)

    try:
        arm.servo_jp(arm.measured_jp())
    except crtk_drivers.CommandRefused as refusal:
        print("a command:", refusal)

    time.sleep(1.0)
    arm.sim.control.clear("emergency_stop")
    arm.enable()  # powers up, and begins from where the arm stands now
    arm.move_jp(arm.setpoint_jp() - 0.1).wait()
    print("and on it goes:", arm.operating_state().state)
