"""Run the README's first command and wait, as its reader would, for the simulated arm to appear.

Fails unless joint states come from /ur5/measured_js within 60 s and Ctrl-C then ends the command
with exit code 0.
"""

import os
import signal
import subprocess
import sys
import time

import rclpy
from sensor_msgs.msg import JointState

COMMAND = ["uv", "run", "crtk-driver", "ur", "--ns", "/ur5", "--sim"]


def first_joint_state(process: subprocess.Popen[bytes], timeout: float) -> JointState:
    """Return the first joint state, in rad, of the command that runs as `process`."""
    received: list[JointState] = []

    def receive(state: JointState) -> None:
        if state.header.stamp.sec:  # 0: not valid, the arm is not connected yet
            received.append(state)

    rclpy.init()
    node = rclpy.create_node("first_command")
    node.create_subscription(JointState, "/ur5/measured_js", receive, 10)
    deadline = time.monotonic() + timeout
    while not received:
        if process.poll() is not None:
            sys.exit(f"{COMMAND} ended by itself, exit code {process.returncode}")
        if time.monotonic() > deadline:
            sys.exit(f"{COMMAND} published no joint state within {timeout:.0f} s")
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.shutdown()
    return received[0]


def main() -> None:
    """Start the command, see its arm, interrupt it."""
    begin = time.monotonic()
    # A session of its own, so that nothing of it outlives a failure.
    process = subprocess.Popen(COMMAND, start_new_session=True)
    try:
        state = first_joint_state(process, timeout=60)
        joints = dict(zip(state.name, state.position, strict=True))
        print(f"first joint state after {time.monotonic() - begin:.1f} s: {joints}")
        # To uv alone, which passes it on: the driver gets one, as it does at a terminal.
        process.send_signal(signal.SIGINT)
        code = process.wait(timeout=10)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if code != 0:
        sys.exit(f"{COMMAND} answered Ctrl-C with exit code {code}")


main()
