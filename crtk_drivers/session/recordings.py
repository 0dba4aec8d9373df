"""The recordings of a running device: a file while it is wanted, and the black box."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from crtk_drivers.config import DeviceConfig
from crtk_drivers.engine import Engine
from crtk_drivers.engine.services import OwnService
from crtk_drivers.errors import CommandRefused, Reason, RecordingError, TransitionFailed
from crtk_drivers.motion.past import Moment
from crtk_drivers.recording import Raw, Recorder, Split, Totals
from crtk_drivers.recording.recorder import CLOSE_TIMEOUT
from crtk_drivers.session.black_box import BlackBox
from crtk_drivers.session.tape import Tape

MEGABYTE: Final = 1_000_000

SERVICES: Final[Mapping[str, str]] = {
    "record_start": "record every sample and command to a new file",
    "record_stop": "end the recording",
    "dump": "write the black box: the last seconds of samples, commands and refusals",
}
"""What is offered for every device, where it has no service of that name."""

LEAVING: Final = 3.0
"""Seconds in which a recording ends with its driver."""

BLACK_BOX: Final = "black_box"
"""What the names of the black box's files end with."""


class Recordings:
    """Records one device and those behind it.

    Args:
        engines: by their sub-namespace; that of the device first, which has none.
        config: of the device.

    Attributes:
        folder: of what is not told where to go; None: there is none, and no black box.
        recorder: what records now; None if nothing does.
        may_be_asked: keep the last seconds without a folder too, for who names a file to `dump`.
    """

    def __init__(self, engines: Mapping[str, Engine], config: DeviceConfig) -> None:
        self._engines = engines
        self._config = config
        self._front = next(iter(engines.values()))
        self._settings = config.recording
        self.folder = Path(self._settings.folder) if self._settings.folder else None
        self.recorder: Recorder | None = None
        self.may_be_asked = False
        self._namespace = f"/{_file_name(self._front.name)}"
        self._attached: list[Callable[[], None]] = []
        self._black_box: BlackBox | None = None
        self._lock = threading.Lock()
        runs = {
            "record_start": lambda: f"recording {self.start()}",
            "record_stop": lambda: _told(self.stop()),
            "dump": lambda: f"the last seconds are in {self.dump('asked for')}",
        }
        self._front.add_services(
            {name: OwnService(SERVICES[name], run) for name, run in runs.items()}
        )

    def place(self, namespace: str) -> None:
        """Put the topics into the namespace of the device; before anything is recorded."""
        self._namespace = namespace

    def begin(self) -> None:
        """Keep the last seconds from now on, if there is a folder for them, or somebody who may ask."""
        is_wanted = self.folder is not None or self.may_be_asked
        if not is_wanted or not self._settings.black_box:
            return
        tapes = [(tape, engine.capabilities.rate) for engine, tape in self._tapes()]
        self._black_box = BlackBox(
            tapes,
            self._settings.black_box,
            partial(self._new_path, BLACK_BOX),
            lambda reason: (self._metadata(reason), self._attachments()),
        )
        self._black_box.start()
        if self.folder is not None:
            self._front.add_observer(self._black_box)

    def start(self, path: str | Path | None = None) -> Path:
        """Record from now on, and return the file.

        Raises:
            CommandRefused: it records already, or nobody said where to.
            RecordingError: the file cannot be made.
        """
        with self._lock:
            if self.recorder is not None:
                raise CommandRefused(
                    "record_start",
                    Reason.INVALID_TRANSITION,
                    f"{self.recorder.series.paths[-1]} is being written",
                    where=self._front.where,
                    remedy="End it with record_stop.",
                )
            path = self._new_path("run") if path is None else Path(path)
            self._record(path)
            return path

    def stop(self, timeout: float = CLOSE_TIMEOUT) -> Totals:
        """End the recording, and return how it went; what waits is written within `timeout` s.

        Raises:
            CommandRefused: nothing is recorded.
            TransitionFailed: it is not complete.
        """
        with self._lock:
            recorder, self.recorder = self.recorder, None
            if recorder is None:
                raise CommandRefused(
                    "record_stop",
                    Reason.INVALID_TRANSITION,
                    "nothing is recorded",
                    where=self._front.where,
                    remedy="Begin with record_start.",
                )
            for detach in self._attached:
                detach()
            self._attached.clear()
            try:
                return recorder.close(timeout)
            except RecordingError as error:
                raise TransitionFailed(
                    error.message, where=error.where, remedy=error.remedy
                ) from error

    def dump(self, reason: str, path: Path | None = None) -> Path:
        """Write what the black box has, and return the file.

        Raises:
            CommandRefused: there is no black box.
            RecordingError: it cannot be written, or is empty.
        """
        if self._black_box is None:
            raise CommandRefused(
                "dump",
                Reason.UNSUPPORTED,
                "there is no black box",
                where=self._front.where,
                remedy="Set recording.folder and recording.black_box, and start anew.",
            )
        return self._black_box.dump(reason, path)

    def close(self) -> None:
        """End what is recorded. May be called twice.

        Raises:
            TransitionFailed: the recording is not complete.
        """
        if self._black_box is not None:
            self._black_box.close()
        if self.recorder is not None:
            self.stop(LEAVING)

    # ---------------------------------------------------------------------------------------- inside

    def _record(self, path: Path) -> None:
        tapes = list(self._tapes())
        split = Split(int(self._settings.split_size * MEGABYTE), self._settings.split_time)

        def look() -> None:
            for _, tape in tapes:
                tape.look()

        recorder = Recorder(
            path,
            metadata=self._metadata("recorded"),
            attachments=self._attachments(),
            split=split,
            keep_free=int(self._settings.keep_free * MEGABYTE),
            before_write=look,
        )
        for engine, tape in tapes:
            for raw in tape.standing():
                recorder.put((_made, raw.topic, raw.log_time, raw))
            keep = _keeper(recorder, tape)
            engine.messages.are_shared = True
            tape.attach(keep, recorder.put)
            self._attached.append(partial(self._detach, engine, tape, keep, recorder))
        self.recorder = recorder
        recorder.start()

    @staticmethod
    def _detach(
        engine: Engine, tape: Tape, keep: Callable[[Moment], object], recorder: Recorder
    ) -> None:
        tape.detach(keep, recorder.put)
        engine.messages.are_shared = False

    def _tapes(self) -> Iterator[tuple[Engine, Tape]]:
        for name, engine in self._engines.items():
            namespace = f"{self._namespace.rstrip('/')}/{name}" if name else self._namespace
            yield engine, Tape(engine, namespace, self._settings.topics)

    def _metadata(self, why: str) -> dict[str, dict[str, str]]:
        engine = self._front
        about = {
            "name": engine.name,
            "address": engine.device.address,
            "namespace": self._namespace,
            "driver_version": _version(),
            "rate": f"{engine.capabilities.rate:g}",
            "joints": " ".join(engine.capabilities.joints),
            "why": why,
        }
        return {"crtk_drivers device": about}

    def _attachments(self) -> dict[str, bytes]:
        return {"configuration.json": self._config.model_dump_json(indent=1).encode()}

    def _new_path(self, kind: str) -> Path:
        """Return a file that is not there yet, in the folder, which is made and kept small.

        Raises:
            RecordingError: there is no folder, or it cannot be made.
        """
        if self.folder is None:
            raise RecordingError(
                "no folder is configured for recordings",
                where=self._front.where,
                remedy="Set recording.folder, or name a file with --record.",
            )
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            make_room(self.folder, int(self._settings.folder_size * MEGABYTE), BLACK_BOX)
        except OSError as error:
            raise RecordingError(
                f"cannot be used for recordings: {error.strerror}",
                where=str(self.folder),
                remedy="Set recording.folder to one that can be written.",
            ) from error
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%f")[:-3]
        name = f"{_file_name(self._front.name)}-{stamp}Z"
        numbers = itertools.count(1)
        path = self.folder / f"{name}-{kind}.mcap"
        while path.exists():  # the time of day was set back
            path = self.folder / f"{name}_{next(numbers)}-{kind}.mcap"
        return path


def make_room(folder: Path, limit: int, kind: str) -> None:
    """Delete the oldest black boxes of a folder until all its recordings take at most `limit` bytes.

    Recordings that somebody asked for are counted, and never deleted; nor is the newest black box, which
    a long recording would push out otherwise. One of a time that is still to come is of before the time of
    day was set back: it is older than all others.
    """
    files, now = [], time.time()
    for path in folder.glob("*.mcap"):
        with contextlib.suppress(OSError):
            found = path.stat()
            made = found.st_mtime if found.st_mtime <= now else -math.inf
            files.append((made, found.st_size, path))
    total = sum(size for _, size, _ in files)
    boxes = sorted(file for file in files if file[2].stem.endswith(kind))
    for _, size, path in boxes[:-1]:
        if total <= limit:
            return
        path.unlink(missing_ok=True)
        total -= size


def state_folder(name: str) -> Path:
    """Return where what a driver keeps for its user goes: systemd's, or that of the user."""
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    base = os.environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    return (Path(given) if given else Path(base) / "crtk-drivers") / _file_name(name)


def _keeper(recorder: Recorder, tape: Tape) -> Callable[[Moment], object]:
    tell, count = tape.teller(), len(tape.names)

    def keep(moment: Moment) -> None:
        recorder.put((tell, "samples", moment[0], moment), count)

    return keep


def _made(topic: str, log_time: int, raw: Raw) -> Sequence[Raw]:
    return (raw,)


def _told(totals: Totals) -> str:
    lost = f"{totals.lost} lost" if totals.lost else "none lost"
    megabytes = totals.size / MEGABYTE
    return f"{totals.written} messages in {totals.files} files, {megabytes:.1f} MB; {lost}"


def _file_name(name: str) -> str:
    return "".join(each if each.isalnum() or each in "-_." else "_" for each in name) or "device"


def _version() -> str:
    try:
        return version("crtk-drivers")
    except PackageNotFoundError:
        return "unknown"
