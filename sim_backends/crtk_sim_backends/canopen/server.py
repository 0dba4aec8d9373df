"""Simulated drives on a bus of their own."""

from __future__ import annotations

from pathlib import Path

from typing_extensions import override

from crtk_sim_backends.can import injection as bus
from crtk_sim_backends.can.hub import Hub
from crtk_sim_backends.can.server import HubServer
from crtk_sim_backends.canopen import scene
from crtk_sim_backends.canopen.config import SimConfig, drive_configs
from crtk_sim_backends.canopen.drive import DriveConfig, eds_of
from crtk_sim_backends.canopen.eds import PUBLISHED
from crtk_sim_backends.canopen.node import BusDrives
from crtk_sim_backends.faults import read_faults
from crtk_sim_backends.page import Live, Scene
from crtk_sim_backends.process import SimStartError


class DrivesServer(HubServer):
    """A bus with its drives in a process of its own.

    Args:
        config: options; everything is bound by the constructor.
        parent_fd: as that of :class:`HubServer`.

    Raises:
        ConfigError: the file with the drives is wrong.
        SimStartError: when something cannot be bound or a file is wrong.
    """

    def __init__(self, config: SimConfig, parent_fd: int | None = None) -> None:
        self.drives = drive_configs(config)
        self.eds = _data_sheet(config)

        self._options = config

        def devices(hub: Hub) -> BusDrives:
            self._made = BusDrives(hub, self.drives)
            _check_faults(config, self._made)
            return self._made

        super().__init__(config, parent_fd, devices)

    @override
    def scene(self) -> Scene:
        return scene.scene(self._options, self.host, list(self.drives))

    @override
    def live(self) -> Live:
        """Add the motors."""
        found = super().live()
        return {**found, "gauges": [scene.gauges(self._made.all), *found["gauges"]]}


def _data_sheet(config: SimConfig) -> Path | None:
    """Write the EDS where the options want it; else that of the drives, if there is one."""
    if config.eds:
        path = Path(config.eds).absolute()
        try:
            path.write_text(eds_of(config.common))
        except OSError as error:
            raise SimStartError(f"cannot write the EDS {path}: {error.strerror}") from error
        return path
    if config.from_eds:
        return Path(config.from_eds).absolute()
    return PUBLISHED if config.common == DriveConfig() else None


def _check_faults(config: SimConfig, drives: BusDrives) -> None:
    """See that the drives are there for which the fault file has something.

    Raises:
        FaultError: a node or an axis is not.
    """
    if not config.faults:
        return
    kinds, events = {**bus.KINDS, **drives.kinds}, (*bus.EVENTS, *drives.events)
    for fault in read_faults(Path(config.faults), kinds, events):
        if fault.kind in drives.kinds:
            drives.chosen(fault)
