"""Commands for people: what an arm is, how it is calibrated, and what it reports."""

from __future__ import annotations

import math
import socket
import statistics
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import yaml
from pydantic import Field
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from crtk_driver_ur.calibration import NOMINAL, Calibration, displacements
from crtk_driver_ur.config import UrConfig
from crtk_driver_ur.frames import Transform, compose, inverse
from crtk_driver_ur.models import JOINT_NAMES, RobotModel, model_named
from crtk_driver_ur.primary import JointLimits, RobotInfo, read_robot_info
from crtk_driver_ur.reports import numbers_of, reports_of
from crtk_driver_ur.robot_api import POLYSCOPE_X, RobotApiClient
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.rtde.stream import RtdeStream
from crtk_drivers.config import Settings
from crtk_drivers.errors import ConfigError, ConnectionFailed, ConnectionLost, TransitionFailed
from crtk_drivers.plugins import Tool

__all__ = ["TOOLS"]

DASHBOARD_PORT: Final = 29999
DASHBOARD_TIMEOUT: Final = 2.5
QUESTIONS: Final = {
    "model": "get robot model",
    "serial number": "get serial number",
    "software": "PolyscopeVersion",
    "loaded program": "get loaded program",
    "remote control": "is in remote control",
}
"""What the dashboard server is asked; older software does not know every question."""
API_QUESTIONS: Final = {
    "model": "robot_model",
    "serial number": "serial_number",
    "software": "polyscope_version",
    "loaded program": "loaded_program",
    "remote control": "is_in_remote_control",
}
"""What the Robot API of PolyScope X is asked; the same."""

AGREES: Final = 1e-3
"""m that a calibration and the controller's tool pose may differ by."""

_OUT = Console(highlight=False)


class InfoOptions(Settings):
    """Options of `info`."""

    output: str | None = Field(
        default=None, description="File for host, model and calibration, as YAML configuration."
    )


def info(config: UrConfig, options: InfoOptions) -> int:
    """Print what the arm is, its calibration beside the model's, its modes, payload and I/O."""
    model = model_named(config.model)
    deadline = time.monotonic() + config.open_timeout
    found = read_robot_info(config.host, deadline)
    state = _state(config, deadline)
    rows = [*_identity(config, found), *_calibrated(model, found, state), *_reports(state)]
    _OUT.print(_table(rows))
    if options.output is not None and found.calibration is not None:
        _write(options.output, _as_configuration(config, found.calibration, found.limits))
    return 0


TOOLS: Final = (
    Tool("info", "tell what an arm is, its calibration, modes, payload and I/O", info, InfoOptions),
)


def ask_dashboard(host: str, questions: Sequence[str], port: int = DASHBOARD_PORT) -> list[str]:
    """Return the answer to each question.

    Raises:
        ConnectionFailed: there is no dashboard server, or it is silent.
    """
    try:
        with (
            socket.create_connection((host, port), DASHBOARD_TIMEOUT) as peer,
            peer.makefile("rw", encoding="utf-8", newline="\n") as lines,
        ):
            answers = [lines.readline()]  # the greeting
            for question in questions:
                lines.write(f"{question}\n")
                lines.flush()
                answers.append(lines.readline())
            if not all(answers):
                raise ConnectionResetError("it closed the connection")
    except (OSError, UnicodeDecodeError) as error:
        raise ConnectionFailed(
            f"the dashboard server cannot be asked: {error}",
            where=f"{host}:{port}",
            remedy="Check the network, and that the controller has finished starting.",
        ) from error
    return [answer.strip() for answer in answers[1:]]


def _identity(config: UrConfig, found: RobotInfo) -> Iterator[tuple[str, str]]:
    yield "address", config.host
    yield "controller version", found.version or ""
    major, minor, *_ = (int(part) for part in (found.version or "0.0").split("."))
    if (major, minor) >= POLYSCOPE_X:
        yield from _from_robot_api(
            RobotApiClient(config.host, config.robot_api_port, (major, minor))
        )
    else:
        yield from _from_dashboard(config.host)
    yield "robot type", "" if found.robot_type is None else str(found.robot_type)


def _from_dashboard(host: str) -> Iterator[tuple[str, str]]:
    try:
        answers = ask_dashboard(host, tuple(QUESTIONS.values()))
    except ConnectionFailed as error:
        yield "dashboard", str(error)
        return
    for name, answer in zip(QUESTIONS, answers, strict=True):
        if not answer.startswith("could not understand"):
            yield name, _without_phrase(answer)


def _from_robot_api(api: RobotApiClient) -> Iterator[tuple[str, str]]:
    for name, question in API_QUESTIONS.items():
        try:
            answer = api.ask(question)
        except TransitionFailed:
            continue  # not in this version
        except (ConnectionFailed, ConnectionLost) as error:
            yield "Robot API", str(error)
            return
        text = str(answer).lower() if isinstance(answer, bool) else answer
        yield name, _without_phrase(text)


def _without_phrase(answer: str) -> str:
    """Return an answer without the words that the name of its row says already."""
    if answer == "No program loaded":
        return "none"
    return answer.removeprefix("Loaded program: ") or "none"


def _calibrated(
    model: RobotModel, found: RobotInfo, state: StateSample
) -> Iterator[tuple[str, str]]:
    calibration = found.calibration
    if calibration is None:
        return
    yield "calibration", " ".join(f"{value:08x}" for value in calibration.checksum)
    away = displacements(model, calibration)
    if max(away) < NOMINAL:
        text = f"the {model.name}'s nominal lengths: not calibrated"
    else:
        text = (
            f"the flange is {statistics.mean(away) * 1e3:.2f} mm (at most {max(away) * 1e3:.2f} mm) "
            f"from where the nominal {model.name} has it"
        )
    yield "compared", text
    if state.tcp_offset is not None:
        tool = Transform.from_pose_vector(state.tcp_offset)
        reported = compose(Transform.from_pose_vector(state.actual_TCP_pose), inverse(tool))
        miss = math.dist(calibration.flange(state.actual_q).position, reported.position)
        agrees = (
            "" if miss < AGREES else ": they do not agree. Is `model` the arm that is connected?"
        )
        yield "checked", f"{miss * 1e3:.3f} mm from the controller's own tool pose{agrees}"


def _reports(state: StateSample) -> Iterator[tuple[str, str]]:
    for note in reports_of(state):
        yield note.key, note.text
    for name, value in numbers_of(state).items():
        yield name, f"{value:.4g}"


def _state(config: UrConfig, deadline: float) -> StateSample:
    stream = RtdeStream(config.host, frequency=config.frequency)
    try:
        stream.open(deadline)
        state = stream.receive(deadline)
    finally:
        stream.close()
    if state is None:
        raise ConnectionFailed(
            "connected, but no state arrives",
            where=f"ur {config.host}",
            remedy="Restart the controller if it stays silent.",
        )
    return state


def _as_configuration(
    config: UrConfig, calibration: Calibration, limits: JointLimits | None
) -> dict[str, Any]:
    values = calibration.model_dump(mode="json")
    found = {"host": config.host, "model": config.model, "calibration": values}
    joints = {} if limits is None else _narrower(model_named(config.model), limits)
    return {**found, "joints": joints} if joints else found


def _narrower(model: RobotModel, limits: JointLimits) -> dict[str, dict[str, float]]:
    """Return what the controller's safety configuration limits beyond the model, as configuration."""
    ranges = model.position_limits
    joints = {}
    for i, name in enumerate(JOINT_NAMES):
        pairs = (
            ("lower", limits.lower[i], limits.lower[i] > ranges.lower[i]),
            ("upper", limits.upper[i], limits.upper[i] < ranges.upper[i]),
            ("velocity", limits.speed[i], limits.speed[i] < model.velocity_limits[i]),
        )
        found = {key: round(value, 6) for key, value, is_narrower in pairs if is_narrower}
        if found:
            joints[name] = found
    return joints


def _write(path: str, values: dict[str, Any]) -> None:
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None)
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot be written: {error}", where=path) from error
    _OUT.print(f"written: {path}", markup=False, soft_wrap=True)


def _table(rows: Sequence[tuple[str, str]]) -> Table:
    table = Table(show_header=False, box=None, pad_edge=False)
    for name, text in rows:
        table.add_row(escape(name), escape(text))
    return table
