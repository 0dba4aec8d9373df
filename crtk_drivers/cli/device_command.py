"""``crtk-driver <device>``: bring a device up as a CRTK node on ROS 2."""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer

from crtk_drivers.cli.coupled_on_ros import coupled_on_ros
from crtk_drivers.cli.help_pages import completed_from
from crtk_drivers.cli.launch import Launch, launch_of, launch_options
from crtk_drivers.cli.log_setup import LEVELS, LogFormat, set_up_logging
from crtk_drivers.cli.status_line import StatusLine
from crtk_drivers.cli.terminal import ERR, plain, sentence
from crtk_drivers.cli.typed_options import (
    Parameters,
    SubCommand,
    given_settings,
    make_command,
    make_group,
    namespace_option,
    option,
    setting_options,
)
from crtk_drivers.config import load
from crtk_drivers.errors import ConfigError, CrtkError
from crtk_drivers.labs.reports import Reporter, whoever_started
from crtk_drivers.plugins import DevicePlugin, RunningSim, Tool
from crtk_drivers.ros import environment
from crtk_drivers.ros.names import checked_namespace
from crtk_drivers.state import Status
from crtk_drivers.status.health import Health
from crtk_drivers.status.stop_request import left_at_interrupt

if TYPE_CHECKING:
    from crtk_drivers.session import Session

logger = logging.getLogger(__name__)

_TOOL_PREFIX = "tool_"

RECORD_OPTION: Final = option(
    "record",
    Path | None,
    None,
    "--record",
    metavar="FILE",
    help="Record every sample and command from the start to this MCAP file; see `crtk-driver plot --help`.",
)

LOG_OPTIONS: Parameters = (
    option(
        "log_level",
        str,
        "info",
        "--log-level",
        metavar="|".join(LEVELS),
        autocompletion=completed_from(lambda: LEVELS),
        help="Least severe records that are shown. [dim]\\[default: info][/dim]",
        show_default=False,
    ),
    option(
        "log_format",
        LogFormat,
        LogFormat.TEXT,
        "--log-format",
        metavar="|".join(LogFormat),
        help="Text with a live status line, or one JSON object a line. "
        "[dim]\\[default: text][/dim]",
        show_default=False,
    ),
)


def build(plugin: DevicePlugin, panel: str) -> Any:
    """Return the command of a device."""
    parameters = [
        namespace_option(plugin.name),
        *launch_options(plugin),
        RECORD_OPTION,
        *LOG_OPTIONS,
    ]

    def run(context: typer.Context, **given: Any) -> int:
        with left_at_interrupt():  # before it serves, which stops the device
            return run_device(plugin, given, context.obj.ros_args)

    example = "--sim" if plugin.sim else ""
    help_text = (
        f"{sentence(plugin.summary)}\n\nRuns until Ctrl-C as a CRTK device on ROS 2. The device starts "
        f"DISABLED, and nothing moves before a client enables it.\n\n"
        f"[dim]Try:[/dim]  crtk-driver {plugin.name} --ns /demo {example}\n\n"
        "[dim]--ros-args and all that follows it goes to ROS 2 as it is.[/dim]"
    )
    if not plugin.tools:
        return make_command(plugin.name, run, parameters, help=help_text, panel=panel)
    tools = [_tool_command(plugin, tool) for tool in plugin.tools]
    return make_group(plugin.name, run, parameters, tools, help=help_text, panel=panel)


def _tool_command(plugin: DevicePlugin, tool: Tool) -> SubCommand:
    own = setting_options(
        tool.options,
        lambda name: f"Options of {tool.name}",
        prefix=_TOOL_PREFIX,
        positional=tool.arguments,
    )

    def run(context: typer.Context, **given: Any) -> int:
        set_up_logging(ERR, given["log_level"], given["log_format"])
        launch = launch_of(plugin, given)
        options = load(tool.options, given_settings(tool.options, given, _TOOL_PREFIX))
        if not launch.sim:
            check = plugin.check_real if tool.check_real is None else tool.check_real
            check(launch.config)
        with launch.reached() as config:
            return tool.run(config, options)

    parameters = [*own, *launch_options(plugin), *LOG_OPTIONS]
    return SubCommand(tool.name, run, parameters, f"{sentence(tool.summary)} Starts no node.")


def _tell_page(sim: RunningSim | None) -> None:
    """Tell where the simulator shows itself, if it does: in no log, since the address lets faults begin."""
    for hint in () if sim is None else getattr(sim, "hints", ()):
        if hint.startswith("page: "):
            ERR.print(plain(hint), soft_wrap=True)


def run_device(plugin: DevicePlugin, given: Mapping[str, Any], ros_args: Sequence[str]) -> int:
    """Run the node until it is told to stop, and return its exit code.

    Raises:
        ConfigError, MissingExtra: it cannot be started as asked.
        ConnectionFailed: the simulator did not start.
    """
    log_format: LogFormat = given["log_format"]
    set_up_logging(ERR, given["log_level"], log_format)
    namespace = checked_namespace(given["ns"])
    launch = launch_of(plugin, given)
    record: Path | None = given["record"]
    if record is not None and record.exists():
        raise ConfigError(
            "is there already", where=f"--record {record}", remedy="Choose another name."
        )
    environment.check()
    reach = environment.reach()
    environment.share_no_memory()
    session = opened(launch)
    from crtk_drivers.ros import serving
    from crtk_drivers.session.recordings import state_folder

    if log_format is LogFormat.TEXT:
        _tell_page(session.sim)
    engine, recordings = session.engine, session.recordings
    if session.config.recording.folder is None:
        recordings.folder = state_folder(engine.name)
    if session.page is not None:
        logger.info("%s: page: %s", engine.name, session.page.address)
    live = ERR.is_terminal and log_format is LogFormat.TEXT

    def read() -> tuple[Status, Health]:
        return engine.status, engine.health()

    reporter = _reporter(read)
    with (
        StatusLine(ERR, f"{engine.name} {namespace}", read, live=live) as line,
        coupled_on_ros(plugin, launch.config, session.sim, launch.carried),
    ):

        def idle() -> None:
            line.update()
            if reporter is not None and not reporter.update():
                logger.warning(
                    "%s: whoever started this is gone or stands still; so it ends", engine.name
                )
                signal.raise_signal(signal.SIGTERM)

        def served(where: str) -> None:
            line.name = f"{engine.name} {where}"
            if record is not None:
                logger.info("%s: recording %s", engine.name, recordings.start(record))
            logger.info("%s", what_next(where, engine.commands))
            if reach:
                logger.warning(
                    "%s can be commanded %s, without a password. To stay on this machine: "
                    "export %s=LOCALHOST",
                    where,
                    reach,
                    environment.RANGE,
                )

        return serving.run(
            session,
            namespace,
            ros_args,
            config=launch.node,
            served=served,
            idle=idle,
        )


def opened(launch: Launch) -> Session:
    """Open it, and load rclpy meanwhile: a simulator takes as long, in a process of its own."""
    with ThreadPoolExecutor(1) as pool:
        opening = pool.submit(launch.open)
        try:
            import_module("crtk_drivers.ros.serving")
        except BaseException:
            with suppress(CrtkError):
                opening.result().close()
            raise
        return opening.result()


def _reporter(read: Callable[[], tuple[Status, Health]]) -> Reporter | None:
    """Return what tells a lab how this device is, if it was started by one."""
    found = whoever_started()
    return None if found is None else Reporter(found[0], read, time.monotonic, found[1])


def what_next(namespace: str, commands: Collection[str]) -> str:
    """Return what a newcomer can do with the device, as commands for another terminal."""
    told = next((name for name in commands if name.startswith("measured_")), "operating_state")
    use = [f"echo {namespace} {told}"]
    if "move_jp" in commands:
        use = [f"enable {namespace}", "move --help"]
    steps = [f"  crtk-driver {step}" for step in (f"state {namespace}", *use)]
    return "\n".join(("in another terminal:", *steps))
