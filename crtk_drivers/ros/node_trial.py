"""Starts a node as a driver does, without a device, and ends: whether an environment lets drivers run.

Run ``python -m crtk_drivers.ros.node_trial '{"plugins": ["ur"], "enclaves": ["/arm/crtk_driver"]}'``. It ends
with 0, or says on standard error in one line why it does not work.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence

from crtk_drivers import plugins
from crtk_drivers.errors import CrtkError
from crtk_drivers.ros import environment


def try_out(order: Mapping[str, Sequence[str]]) -> None:
    """Load plugins, and start a node in each enclave; an empty one is what ROS 2 takes if nothing is said.

    Raises:
        CrtkError: something is not installed, or the environment asks for what cannot work.
        Exception: ROS 2 does not start, as it says itself.
    """
    for name in order["plugins"]:
        plugins.device(name)
    environment.check()
    environment.share_no_memory()
    import rclpy  # what is not installed was told by `check`
    from rclpy.context import Context

    for enclave in order["enclaves"]:
        context = Context()
        arguments = ["--ros-args", "--enclave", enclave] if enclave else []
        rclpy.init(args=arguments, context=context)
        try:
            rclpy.create_node(
                "crtk_trial", context=context, enable_rosout=False, start_parameter_services=False
            ).destroy_node()
        finally:
            context.try_shutdown()


if __name__ == "__main__":
    try:
        try_out(json.loads(sys.argv[1]))
    except CrtkError as error:
        sys.exit(str(error))
    except Exception as error:
        sys.exit(f"ROS 2 does not start: {' '.join(str(error).split())}")
