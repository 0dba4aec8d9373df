"""The simulated gripper behind its ports."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from crtk_sim_backends.kit import LoopServer, TcpDoor
from crtk_sim_backends.kit.jaw import Jaw
from crtk_sim_backends.kit.modbus_line import Distortion
from crtk_sim_backends.kit.modbus_server import Later, serve_modbus
from crtk_sim_backends.robotiq.config import SimConfig
from crtk_sim_backends.robotiq.controller import ControllerSession
from crtk_sim_backends.robotiq.gripper import Gripper
from crtk_sim_backends.robotiq.models import MODELS
from crtk_sim_backends.robotiq.urcap import UrcapSession


def serve(config: SimConfig, parent_fd: int | None) -> LoopServer:
    """Bind the ports of a simulated gripper."""
    band = config.band_open, config.band_closed
    opening = MODELS[config.model].stroke * (1.0 - config.closed)
    gripper = Gripper(
        config.model,
        Jaw(opening, config.object_width, config.object_stiffness),
        band,
        activated=config.activated,
        lag=config.object_lag,
        sweep_speed=config.sweep_speed,
        defects=config.gripper_defects,
    )
    end = b"\n" if config.urcap_newline else b""

    def more_ports(distortion: Distortion, later: Callable[[str], Later]) -> Mapping[str, TcpDoor]:
        def session() -> UrcapSession:
            return UrcapSession(gripper, distortion, end, later("urcap"))

        def client() -> ControllerSession:
            return ControllerSession(
                gripper, distortion, config.controller_unit, later("controller")
            )

        return {
            "controller": TcpDoor(config.controller_port, client),
            "urcap": TcpDoor(config.urcap_port, session),
        }

    title = f"Robotiq {config.model.upper()}"
    return serve_modbus(config, parent_fd, gripper, title, more_ports)
