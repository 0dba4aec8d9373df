"""What one RTDE package and one command cost the driver of a UR arm, in one thread."""

from __future__ import annotations

import time

from bench.report import options, show_calls
from crtk_driver_ur.frames import Transform
from crtk_driver_ur.kinematics import ArmKinematics
from crtk_driver_ur.library import packets
from crtk_driver_ur.library.packets import MotionCommand, MotionKind
from crtk_driver_ur.models import model_named
from crtk_driver_ur.rtde import codec
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.rtde.variables import OUTPUTS, TYPES
from crtk_driver_ur.samples import SampleMaker
from crtk_drivers.samples import vector

JOINTS = (0.1, -1.5, 1.4, -1.6, -1.5, 0.2)


def package() -> tuple[codec.RtdeDecoder, bytes]:
    """Return a decoder that knows the driver's recipe, and one package of it."""
    recipe = codec.Recipe(1, tuple(OUTPUTS), tuple(OUTPUTS.values()))
    decoder = codec.RtdeDecoder()
    decoder.protocol_version = 2
    decoder.add_recipe(recipe)
    values: list[object] = []
    for kind in map(TYPES.__getitem__, OUTPUTS.values()):
        numbers = JOINTS if kind.code == "d" else (1,) * len(JOINTS)
        values.append(numbers[: kind.width] if kind.width > 1 else numbers[0])
    return decoder, codec.encode_data(recipe, values)


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", calls=(2000, "in each round"))
    decoder, data = package()
    (decoded,) = decoder.feed(data)
    assert isinstance(decoded, codec.DataPackage)
    values = decoded.values()
    state = StateSample(time.monotonic(), 0, 0, False, (), *values)  # type: ignore[arg-type]
    maker, moved = SampleMaker(None), SampleMaker(Transform.from_pose_vector((0, 0, 0.1, 0, 0, 0)))
    kinematics = ArmKinematics(model_named("ur5e"))
    joints = vector(JOINTS)
    pose = kinematics.place(JOINTS)
    command = MotionCommand(1, MotionKind.SERVO_JOINT, JOINTS, 0.0, 0.0)
    frame = packets.encode(command)
    show_calls(
        f"UR driver: one RTDE package ({len(data)} bytes, {len(OUTPUTS)} variables) and one command",
        {
            "frame the package": lambda: decoder.feed(data),
            "frame and decode the package": lambda: decoder.feed(data)[0].values(),  # type: ignore[union-attr]
            "make the CRTK sample": lambda: maker.make(state),
            "make it for a tool of one's own": lambda: moved.make(state),
            "encode a command for the control process": lambda: packets.encode(command),
            "decode it there": lambda: packets.decode(frame),
            "forward kinematics": lambda: kinematics.place(JOINTS),
            "inverse kinematics, nearest": lambda: kinematics.solve(pose, JOINTS),
            "Jacobian": lambda: kinematics.jacobian(joints),
        },
        given.calls,
    )


if __name__ == "__main__":
    main()
