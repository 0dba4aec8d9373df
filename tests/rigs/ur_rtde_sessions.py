"""What the unmodified ur_rtde library does with a simulated controller, each in its own process.

``python ur_rtde_sessions.py SESSION HOST CONTROL_PORT`` prints the results as one line of JSON. The
library may crash or hold the interpreter, which must not happen to the tests.
"""

import json
import sys
import time

import dashboard_client
import rtde_control
import rtde_io
import rtde_receive

from crtk_sim_backends.control import ControlClient


def distance(a, b):
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def wait_until(condition, seconds=60.0):
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True


class Session:
    def __init__(self, host, control_port):
        self.host = host
        self.sim = ControlClient(host, control_port)
        self.receive = rtde_receive.RTDEReceiveInterface(host)
        self.control = rtde_control.RTDEControlInterface(host)
        self.home = self.receive.getActualQ()

    def arrived(self, target, tolerance=1e-3):
        return wait_until(lambda: distance(self.receive.getActualQ(), target) < tolerance)

    def resting(self):
        return wait_until(lambda: max(map(abs, self.receive.getActualQd())) < 1e-3)

    def close(self):
        self.control.stopScript()
        self.control.disconnect()
        self.receive.disconnect()
        self.sim.close()

    def constructs(self):
        return {
            "connected": self.control.isConnected() and self.receive.isConnected(),
            "playing": self.receive.getRuntimeState() == 2,
        }

    def short(self):
        target = [q + 0.1 for q in self.home]
        return {
            "connected": self.control.isConnected() and self.receive.isConnected(),
            "playing": wait_until(lambda: self.receive.getRuntimeState() == 2),
            "moveJ": self.control.moveJ(target, 1.0, 2.0),
            "arrived": self.arrived(target),
        }

    def moves(self):
        control = self.control
        target = [q + 0.2 for q in self.home]
        result = {"moveJ": control.moveJ(target, 1.0, 2.0), "moveJ_arrived": self.arrived(target)}
        pose = self.receive.getActualTCPPose()
        goal = [pose[0], pose[1], pose[2] + 0.05, *pose[3:]]
        result["moveL"] = control.moveL(goal, 0.25, 1.0)
        result["moveL_error"] = distance(self.receive.getActualTCPPose()[:3], goal[:3])
        result["FK_error"] = distance(control.getForwardKinematics(), goal)
        solution = control.getInverseKinematics(goal)
        result["IK_error"] = distance(solution, self.receive.getActualQ())
        result["steady"] = wait_until(control.isSteady)
        result["moveJ_async"] = control.moveJ(self.home, 0.5, 1.0, True)
        result["moving"] = wait_until(lambda: max(map(abs, self.receive.getActualQd())) > 0.05)
        control.stopJ(2.0)
        result["stopped"] = self.resting()
        result["short_of_goal"] = distance(self.receive.getActualQ(), self.home) > 0.01
        result["in_limits"] = control.isJointsWithinSafetyLimits(self.home)
        return result

    def streams(self):
        control, receive = self.control, self.receive
        target = list(self.home)
        for _ in range(200):
            start = control.initPeriod()
            target = [q + 0.0004 for q in target]
            control.servoJ(target, 0, 0, 0.002, 0.05, 500)
            control.waitPeriod(start)
        result = {}
        for _ in range(100):
            start = control.initPeriod()
            control.servoJ(target, 0, 0, 0.002, 0.05, 500)
            control.waitPeriod(start)
        result["servoJ_error"] = distance(receive.getActualQ(), target)
        result["servoStop"] = control.servoStop()
        result["servo_rest"] = self.resting()

        control.speedJ([0.0, 0.0, 0.0, 0.0, 0.0, 0.2], 1.0, 0.0)
        result["speedJ"] = wait_until(lambda: abs(receive.getActualQd()[5] - 0.2) < 0.01)
        result["speedStop"] = control.speedStop()
        result["speed_rest"] = self.resting()

        control.speedL([0.0, 0.0, 0.05, 0.0, 0.0, 0.0], 0.5, 0.0)
        result["speedL"] = wait_until(lambda: abs(receive.getActualTCPSpeed()[2] - 0.05) < 0.005)
        control.speedStop()
        result["speedL_rest"] = self.resting()

        control.jogStart([0.0, 0.0, -20.0, 0.0, 0.0, 0.0], 0)
        result["jog"] = wait_until(lambda: receive.getActualTCPSpeed()[2] < -0.005)
        result["jogStop"] = control.jogStop()
        result["jog_rest"] = self.resting()
        return result

    def settings(self):
        control, receive = self.control, self.receive
        io = rtde_io.RTDEIOInterface(self.host)
        result = {"payload": control.setPayload(1.5, [0.0, 0.0, 0.05])}
        result["payload_seen"] = wait_until(lambda: abs(receive.getPayload() - 1.5) < 1e-6)
        control.setTcp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
        result["tcp"] = distance(control.getTCPOffset(), [0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
        result["zeroFt"] = control.zeroFtSensor()
        io.setStandardDigitalOut(3, True)
        result["digital"] = wait_until(lambda: receive.getActualDigitalOutputBits() & 8)
        io.setSpeedSlider(0.5)
        result["slider"] = wait_until(lambda: receive.getTargetSpeedFraction() == 0.5)
        io.setAnalogOutputVoltage(0, 0.5)
        result["analog"] = wait_until(lambda: abs(receive.getStandardAnalogOutput0() - 5.0) < 0.01)
        io.disconnect()
        return result

    def watchdog(self):
        control, receive = self.control, self.receive
        result = {"set": control.setWatchdog(4.0)}
        for _ in range(20):
            result["kicked"] = control.kickWatchdog()
            time.sleep(0.02)
        result["alive"] = receive.getRuntimeState() == 2
        before = self.sim.status()["input_packages"]
        control.kickWatchdog()
        last = receive.getTimestamp()
        result["stopped"] = wait_until(lambda: receive.getRuntimeState() == 1)
        result["after"] = receive.getTimestamp() - last
        result["kick_seen"] = self.sim.status()["input_packages"] > before
        return result

    def protective_stop(self):
        control, receive = self.control, self.receive
        dashboard = dashboard_client.DashboardClient(self.host)
        dashboard.connect()
        result = {"moveJ": control.moveJ([q + 0.5 for q in self.home], 0.2, 0.5, True)}
        result["moving"] = wait_until(lambda: max(map(abs, receive.getActualQd())) > 0.05)
        self.sim.inject("protective_stop")
        result["stop_seen"] = wait_until(receive.isProtectiveStopped)
        result["program_ended"] = wait_until(lambda: receive.getRuntimeState() != 2)
        result["rest"] = self.resting()
        result["refused"] = not control.moveJ(self.home, 1.0, 2.0)
        try:
            dashboard.unlockProtectiveStop()
            result["unlocked_at_once"] = True
        except RuntimeError:
            result["unlocked_at_once"] = False
        until = self.sim.status()["time"] + 0.5  # as the test has it
        wait_until(lambda: self.sim.status()["time"] > until)
        dashboard.unlockProtectiveStop()
        result["released"] = wait_until(lambda: not receive.isProtectiveStopped())
        control.reuploadScript()
        # The control interface refuses to move until its own stream, too, shows a program.
        result["playing"] = wait_until(control.isProgramRunning)
        result["moves_again"] = control.moveJ(self.home, 1.0, 2.0)
        result["arrived"] = self.arrived(self.home)
        dashboard.disconnect()
        return result


def main(kind):
    name, host, control_port = sys.argv[1:]
    session = kind(host, int(control_port))
    try:
        result = getattr(session, name)()
    finally:
        session.close()
    print(json.dumps(result))  # noqa: T201


if __name__ == "__main__":
    main(Session)
