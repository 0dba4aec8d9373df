"""Where the tool of one arm is: lengths and angles of its links, and its tool centre point."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterator
from typing import Final

from crtk_driver_ur.calibration import NOMINAL, CalibratedKinematics, Calibration, displacements
from crtk_driver_ur.config import UrConfig
from crtk_driver_ur.frames import IDENTITY, Transform
from crtk_driver_ur.kinematics import ArmKinematics
from crtk_driver_ur.models import JOINT_NAMES, RobotModel
from crtk_driver_ur.primary import JointLimits, read_robot_info
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.safety import RobotMode
from crtk_driver_ur.samples import SampleMaker
from crtk_drivers.device import Note, Severity
from crtk_drivers.errors import DeviceError, TransitionFailed

__all__ = ["ArmGeometry"]

CALIBRATION_TIMEOUT: Final = 1.0
"""Seconds for the controller to tell its calibration."""

LEAST_TIME: Final = 0.3
"""Seconds of these that it gets where connecting has taken all the others."""

MODEL_TOLERANCE: Final = 0.05
"""m between the tool as the controller and as the model places it; calibration accounts for a few mm."""

logger = logging.getLogger(__name__)


class ArmGeometry:
    """The kinematics of one arm, as the configuration and the controller have them.

    Args:
        config: of the arm.
        model: the arm.
        where: the device, for messages.

    Attributes:
        kinematics: with the tool centre point that counts now.
        samples: makes them, for the same point.
        note: what people should know of the calibration.
        limit_notes: what they should know of ranges and speeds.
        arm: the model with the ranges and speeds that hold: as configured, and as the controller told.
    """

    def __init__(self, config: UrConfig, model: RobotModel, where: str) -> None:
        self._config = config
        self._model = model
        self._where = where
        self._tool = None if config.tcp is None else Transform.from_pose_vector(config.tcp)
        given = config.calibration
        self._calibration = given if isinstance(given, Calibration) else None
        self._reported: tuple[float, ...] | None = None
        self.kinematics = self._with(self._tool or IDENTITY)
        self.samples = SampleMaker(self._tool)
        self.note: Note | None = None
        self._told_misfits: tuple[TransitionFailed, ...] = ()
        self.limit_notes: tuple[Note, ...] = ()
        self.arm = model

    def _with(self, tool: Transform) -> ArmKinematics:
        if self._calibration is None:
            return ArmKinematics(self._model, tool)
        return CalibratedKinematics(self._model, self._calibration, tool)

    # The tool

    def use_tool(self, tool: Transform) -> None:
        """Compute with another tool from now on. From any thread, at rest."""
        self._tool = tool
        self.kinematics = self._with(tool)
        self.samples = SampleMaker(tool)

    def follow_tool(self, state: StateSample) -> None:
        """Compute with the controller's tool where the configuration names none."""
        reported = state.tcp_offset
        if self._tool is None and reported is not None and reported != self._reported:
            self._reported = reported
            self.kinematics = self._with(Transform.from_pose_vector(reported))

    # The links

    def misfits(self, state: StateSample | None) -> Iterator[TransitionFailed]:
        """Yield why the arm that is connected cannot be the configured one.

        Args:
            state: the newest. Only while the arm has power, it says where the tool is.
        """
        yield from self._told_misfits
        if state is None or state.tcp_offset is None or state.robot_mode < RobotMode.IDLE:
            return
        # What the controller tells of itself fits it always: the model must, or the configured table.
        tool = Transform.from_pose_vector(state.tcp_offset)
        given = isinstance(self._config.calibration, Calibration)
        kinematics = self._with(tool) if given else ArmKinematics(self._model, tool)
        expected = kinematics.place(state.actual_q).position
        distance = math.dist(expected, state.actual_TCP_pose[:3])
        if distance > MODEL_TOLERANCE:
            yield self._stranger(
                f"the controller has the tool {distance:.3f} m from where that "
                f"{'calibration' if given else 'model'} has it"
            )

    def _stranger(self, why: str) -> TransitionFailed:
        given = isinstance(self._config.calibration, Calibration)
        return TransitionFailed(
            f"this is no {self._model.name}: {why}",
            where=self._where,
            remedy="Set `model` to the arm that is connected"
            + (", and `calibration` to its own." if given else "."),
        )

    def learn_calibration(self, deadline: float) -> None:
        """Ask the controller for its calibration: compute with it, or compare it with the configured one."""
        configured = self._config.calibration
        self.note, self._told_misfits = None, ()
        self.limit_notes, self.arm = (), self._model
        try:
            now = time.monotonic()
            soon = max(now + LEAST_TIME, min(deadline, now + CALIBRATION_TIMEOUT))
            told = read_robot_info(self._config.host, soon)
        except DeviceError as error:
            self._not_told(error)
            return
        self._learn_limits(told.limits)
        found = told.calibration
        self._compare(found)
        if configured == "nominal":
            return
        if not isinstance(configured, Calibration):
            self._adopt(found)
        elif found is None or found.checksum != configured.checksum:
            self._warn(
                "the controller has another one than is configured. Make it anew with "
                "`crtk-driver ur info --output`, or leave it out."
            )

    def _compare(self, found: Calibration | None) -> None:
        """Compare the links of the controller's arm with those of the model; they are known without power."""
        if found is None or isinstance(self._config.calibration, Calibration):
            return  # with a table of its own it is that one that must fit, as the tool is placed
        away = max(displacements(self._model, found))
        if away > MODEL_TOLERANCE:
            why = f"the links of the controller's arm place a tool up to {away:.3f} m elsewhere"
            self._told_misfits = (self._stranger(why),)

    def _learn_limits(self, told: JointLimits | None) -> None:
        """Keep the control program within the controller's own limits, and say where these are narrower."""
        if told is None:
            return
        model, notes = self._model, []
        rows = zip(
            JOINT_NAMES,
            zip(told.lower, told.upper, told.speed, strict=True),
            zip(
                model.position_limits.lower,
                model.position_limits.upper,
                model.velocity_limits,
                strict=True,
            ),
            strict=True,
        )
        narrower = {}
        for name, (lower, upper, speed), (least, most, fastest) in rows:
            if lower > least or upper < most or speed < fastest:
                narrower[name] = (lower, upper, speed)
                notes.append(
                    Note(
                        Severity.WARNING,
                        name,
                        f"the controller holds it within [{lower:.3f}, {upper:.3f}] rad, {speed:.3f} rad/s "
                        "by its safety configuration; set `joints`, so that commands beyond are refused "
                        "(`crtk-driver ur info --output` writes it)",
                    )
                )
        self.limit_notes = tuple(notes)
        self.arm = model.limited_to(narrower)

    def _not_told(self, error: DeviceError) -> None:
        if self._config.calibration == "nominal":
            logger.warning("%s: the controller does not tell its limits: %s", self._where, error)
            return
        used = "the configured one is used"
        if not isinstance(self._config.calibration, Calibration):
            self._use(None)
            used = f"the lengths of the nominal {self._model.name} are used"
        self._warn(f"the controller's is not known, {used}: {error}")

    def _adopt(self, found: Calibration | None) -> None:
        """Compute with what the controller told, unless that is no calibration of this model."""
        self._use(None)
        away = 0.0 if found is None else max(displacements(self._model, found))
        if away > MODEL_TOLERANCE:
            self._warn(f"the controller's does not fit a {self._model.name}: check `model`")
        elif away > NOMINAL:
            self._use(found)
            text = (
                f"the controller's: up to {1e3 * away:.2f} mm from the nominal {self._model.name}"
            )
            self.note = Note(Severity.INFO, "calibration", text)

    def _use(self, calibration: Calibration | None) -> None:
        self._calibration, self._reported = calibration, None
        self.kinematics = self._with(self._tool or IDENTITY)

    def _warn(self, text: str) -> None:
        logger.warning("%s: calibration: %s", self._where, text)
        self.note = Note(Severity.WARNING, "calibration", text)
