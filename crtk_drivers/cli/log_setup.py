"""Logging of a run: text for people or one JSON object a line for programs, to standard error."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from rich.console import Console
from rich.text import Text
from typing_extensions import override

from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.wording import worded

LEVELS: Final = ("debug", "info", "warning", "error")
_STYLES: Mapping[int, str] = MappingProxyType(
    {
        logging.DEBUG: "dim",
        logging.INFO: "cyan",
        logging.WARNING: "yellow",
        logging.ERROR: "bold red",
        logging.CRITICAL: "bold white on red",
    }
)
_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


class LogFormat(StrEnum):
    """How a record is written."""

    TEXT = "text"
    JSON = "json"


class JsonFormatter(logging.Formatter):
    """One JSON object a line: time (UTC), level, logger, message, extra fields, exception."""

    @override
    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        whole = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        entry = {
            "time": f"{whole}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        entry |= {key: value for key, value in vars(record).items() if key not in _STANDARD}
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, default=str)


class TextFormatter(logging.Formatter):
    """What happened, with commands as the reader would give them."""

    @override
    def format(self, record: logging.LogRecord) -> str:
        """Return the message, and a traceback if it has one."""
        return worded(super().format(record))


class _ConsoleHandler(logging.Handler):
    """Writes through a rich console, so that a live status line stays below the records."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console

    @override
    def emit(self, record: logging.LogRecord) -> None:
        """Write one record."""
        try:
            if isinstance(self.formatter, JsonFormatter):
                line = Text(self.format(record))
            else:
                line = Text.assemble(
                    (time.strftime("%H:%M:%S ", time.localtime(record.created)), "dim"),
                    (f"{record.levelname.lower():<8}", _STYLES.get(record.levelno, "")),
                    self.format(record),
                )
            self._console.print(line, soft_wrap=True)
        except Exception:
            self.handleError(record)


def set_up_logging(console: Console, level: str, form: LogFormat) -> None:
    """Send the records of all loggers to `console`. Replaces what was set up before.

    Raises:
        ConfigError: no such level.
    """
    if level.lower() not in LEVELS:
        raise ConfigError(
            f"{level!r} is not a log level",
            where="--log-level",
            remedy=f"One of {', '.join(LEVELS)}.",
        )
    handler = _ConsoleHandler(console)
    handler.setFormatter(
        JsonFormatter() if form is LogFormat.JSON else TextFormatter("%(message)s")
    )
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    logging.captureWarnings(True)
