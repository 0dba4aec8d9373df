"""What the unmodified ur_rtde library moves on a simulated controller; see `ur_rtde_sessions`."""

import time

from rtde_control import Path, PathEntry
from ur_rtde_sessions import Session, distance, main, wait_until

TABLE = 0.04  # m below the tool, where a surface is
DOWN = [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
LIMITS = [0.1] * 6


class Motions(Session):
    def __init__(self, host, control_port):
        super().__init__(host, control_port)
        # Its commands are refused until its own stream, too, shows a program.
        wait_until(self.control.isProgramRunning)

    def shifted(self, x=0.0, y=0.0, z=0.0):
        pose = self.start
        return [pose[0] + x, pose[1] + y, pose[2] + z, *pose[3:]]

    def path(self, radius):
        path = Path()
        corners = (self.shifted(y=0.1), self.shifted(y=0.1, z=0.1), self.shifted(z=0.1))
        for i, (kind, pose) in enumerate(
            zip((PathEntry.MoveL, PathEntry.MoveL, PathEntry.MoveP), corners, strict=True)
        ):
            blend = 0.0 if i == 2 else radius
            path.addEntry(PathEntry(kind, PathEntry.PositionTcpPose, [*pose, 0.4, 3.0, blend]))
        return path

    def progress_of(self, control):
        """Progress of the running operation, until it ends."""
        seen = []

        def ended():
            status = control.getAsyncOperationProgressEx()
            if not status.isAsyncOperationRunning():
                return bool(seen)
            if not seen or seen[-1] != status.progress():
                seen.append(status.progress())
            return False

        return seen if wait_until(ended, 20.0) else []

    def paths(self):
        control, receive = self.control, self.receive
        self.start = receive.getActualTCPPose()
        result = {"blended": control.movePath(self.path(0.03))}
        result["blended_error"] = distance(receive.getActualTCPPose()[:3], self.shifted(z=0.1)[:3])
        control.moveL(self.start, 0.5, 3.0)
        result["async"] = control.movePath(self.path(0.03), True)
        result["progress"] = self.progress_of(control)
        result["async_error"] = distance(receive.getActualTCPPose()[:3], self.shifted(z=0.1)[:3])
        control.moveL(self.start, 0.5, 3.0)
        result["waypoint"] = distance(control.getTargetWaypoint()[:3], self.start[:3]) < 1e-6
        control.servoC(self.shifted(y=0.05), 0.2, 2.0, 0.0)
        result["servoC"] = wait_until(
            lambda: distance(receive.getActualTCPPose()[:3], self.shifted(y=0.05)[:3]) < 1e-3
        )
        # The library never sees the end of servoC, and so swallows the command after it.
        return result

    def contact(self):
        control, receive = self.control, self.receive
        control.moveJ(self.home, 1.0, 2.0)
        self.start = receive.getActualTCPPose()
        table = self.start[2] - TABLE
        self.sim.inject("surface", point=[0.0, 0.0, table], normal=[0.0, 0.0, 1.0])
        result = {"untilContact": control.moveUntilContact([0, 0, -0.05, 0, 0, 0], DOWN)}
        result["at_table"] = abs(receive.getActualTCPPose()[2] - table)
        control.moveL(self.start, 0.5, 3.0)

        result["forceMode"] = control.forceMode(
            [0.0] * 6, [0, 0, 1, 0, 0, 0], [0.0, 0.0, -20.0, 0.0, 0.0, 0.0], 2, LIMITS
        )
        result["pressed"] = wait_until(lambda: abs(receive.getActualTCPForce()[2] - 20.0) < 1.0, 20)
        result["touches"] = wait_until(lambda: control.toolContact(DOWN) > 0)
        result["forceModeStop"] = control.forceModeStop()
        result["up"] = control.moveL(self.start, 0.5, 3.0)

        result["detecting"] = control.startContactDetection(DOWN)
        control.moveL(self.shifted(z=-0.1), 0.05, 1.0, True)
        # Polling `readContactDetection` would make the library's program miss the contact.
        result["moving"] = wait_until(lambda: receive.getActualTCPSpeed()[2] < -0.04, 20.0)
        result["touched"] = wait_until(lambda: receive.getActualTCPForce()[2] > 1.0, 20.0)
        result["rest"] = self.resting()
        result["detected"] = control.stopContactDetection()
        result["stopped_at_table"] = abs(receive.getActualTCPPose()[2] - table)
        result["up_again"] = control.moveL(self.start, 0.5, 3.0)
        self.sim.clear("surface")
        return result

    def freedrive(self):
        control, receive = self.control, self.receive
        start = receive.getActualTCPPose()
        result = {"freedrive": control.freedriveMode([0, 1, 0, 0, 0, 0])}
        self.sim.inject("external_force", wrench=[20.0, 20.0, 20.0, 0.0, 0.0, 0.0])
        result["gave_way"] = wait_until(lambda: receive.getActualTCPPose()[1] - start[1] > 0.03)
        self.sim.clear("external_force")
        result["status"] = control.getFreedriveStatus() == 0
        result["end"] = control.endFreedriveMode()
        result["rest"] = self.resting()
        pose = receive.getActualTCPPose()
        result["across"] = max(abs(pose[0] - start[0]), abs(pose[2] - start[2]))
        result["teach"] = control.teachMode()
        result["end_teach"] = control.endTeachMode()
        return result

    def dynamics(self):
        control, receive = self.control, self.receive
        control.moveJ([q + 0.1 for q in self.home], 1.0, 2.0)
        self.resting()
        mass = control.getMassMatrix([], True)
        time.sleep(0.02)  # the library returns what the registers held before
        mass = control.getMassMatrix([], True)
        control.getJacobian([], [])
        time.sleep(0.02)
        jacobian = control.getJacobian([], [])
        control.getCoriolisAndCentrifugalTorques([], [])
        time.sleep(0.02)
        coriolis = control.getCoriolisAndCentrifugalTorques([], [])
        return {
            "q": receive.getActualQ(),
            "mass": mass,
            "jacobian": jacobian,
            "coriolis": coriolis,
        }

    def torque(self):
        control, receive = self.control, self.receive
        result = {"sent": True}

        def pushed():
            result["sent"] = result["sent"] and control.directTorque([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
            return receive.getActualQd()[5] > 0.1

        result["turned"] = wait_until(pushed)
        control.stopJ(2.0)
        result["rest"] = self.resting()
        return result


if __name__ == "__main__":
    main(Motions)
