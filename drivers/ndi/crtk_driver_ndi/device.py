"""A tracker as a CRTK device; its tools are devices behind it. ENABLED means that it tracks."""

from __future__ import annotations

import logging
from collections.abc import Mapping

from typing_extensions import override

from crtk_driver_ndi.codec import error_text
from crtk_driver_ndi.config import NdiConfig
from crtk_driver_ndi.frames import PARSERS, STRAY_PARSERS, SYSTEM_STATUS, Frame, told
from crtk_driver_ndi.setup import ASK_STEP, step_told
from crtk_driver_ndi.stream import FrameStream
from crtk_driver_ndi.tool import MM, STOP, ToolDevice, place_of
from crtk_driver_ndi.tracker import WRONG_MODE, Tracker
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Answer,
    Capabilities,
    Condition,
    Device,
    Note,
    Reading,
    Sensor,
    Service,
    Severity,
    Steps,
)
from crtk_drivers.errors import ConfigError, CrtkError, TransitionFailed, raise_first
from crtk_drivers.geometry.frames import relative
from crtk_drivers.samples import Number, Pose, Poses, Sample, Stamp, vector

__all__ = ["NdiDevice"]

logger = logging.getLogger(__name__)

UNTURNED = vector((0.0, 0.0, 0.0, 1.0))


class NdiDevice(Sensor):
    """One tracker. What it sees its tools tell.

    Args:
        config: of it and its tools.

    Raises:
        ConfigError: the definition of a tool cannot be read, names are there twice, or there is no
            such reference.
    """

    def __init__(self, config: NdiConfig) -> None:
        self._config = config
        self._tracker = Tracker(config)
        names = [tool.namespace for tool in config.tools]
        if len(set(names)) < len(names):
            twice = max(names, key=names.count)
            raise ConfigError(f"two tools are called {twice}", where="ndi", remedy="Name them.")
        if config.frame_id in names:
            raise ConfigError(
                f"frame_id: a tool is called {config.frame_id}, too",
                where="ndi",
                remedy="Call one of them otherwise: each tool has a frame of its name.",
            )
        if config.reference and config.reference not in names:
            raise ConfigError(
                f"reference: there is no tool {config.reference!r}",
                where="ndi",
                remedy=f"Tools are: {', '.join(names) or 'none'}.",
            )
        reference = names.index(config.reference) if config.reference else None
        self._reference = reference
        self._frame = config.reference or config.frame_id
        self._last = Poses((), self._frame)
        self._tools = {
            name: ToolDevice(self._tracker, name, place, None if place == reference else reference)
            for place, name in enumerate(names)
        }
        self._capabilities = Capabilities(
            type="tracker",
            measured=("measured_cp_array",),
            rate=config.rate,
            paced_by_stream=True,
            base_frame=config.frame_id,
            tool_frame=config.frame_id,
            transition_timeout=15.0,
            stop=STOP,
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return self._tracker.address

    @property
    @override
    def children(self) -> Mapping[str, Device]:
        return self._tools

    @property
    def stream(self) -> FrameStream | None:
        """Every frame, with its stamp, for programs in this process; None while it does not track."""
        return self._tracker.stream

    @property
    @override
    def condition(self) -> Condition:
        return self._tracker.condition

    @override
    def open(self, deadline: float) -> None:
        self._tracker.open(deadline)
        logger.info("%s: %s; %s", self.address, self._product, self._plugged)

    @override
    def abort_open(self) -> None:
        self._tracker.abort()

    @override
    def close(self) -> None:
        self._tracker.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        """Return all that the newest frame shows: nothing while it does not track, and answers."""
        if not self._tracker.read(deadline):
            return None
        stream, frame = self._tracker.stream, None
        if stream is not None:
            frame = stream.newest
        if stream is None or frame is None:
            return Sample(Stamp.now(), {"measured_cp_array": Poses((), self._frame)})
        seen = self._seen(frame)
        if seen is None:
            return Sample(Stamp(0, stream.stamp.monotonic), {"measured_cp_array": self._last})
        self._last = seen
        return Sample(stream.stamp, {"measured_cp_array": seen})

    def _seen(self, frame: Frame) -> Poses | None:
        """Return where tools and strays are; None while the reference is missing."""
        config = self._config
        found = [place_of(self._tracker, place) for place in range(len(config.tools))]
        poses = [pose for pose in found if pose is not None]
        poses += [
            Pose(vector((MM * stray.x, MM * stray.y, MM * stray.z)), UNTURNED)
            for stray in frame.strays
            if config.outside == "tell" or not stray.out_of_volume
        ]
        if self._reference is None:
            return Poses(tuple(poses), self._frame)
        reference = found[self._reference]
        if reference is None:
            return None
        return Poses(tuple(relative(reference, pose) for pose in poses), self._frame)

    @override
    def enable(self) -> Steps:
        """Track.

        Raises:
            TransitionFailed: it has no tool, or refuses.
        """
        raise_first(self.obstacles)
        tracker, prepared = self._tracker, self._tracker.prepared
        assert prepared is not None
        tracker.condition = Condition()
        step = step_told((yield from tracker.asking(ASK_STEP)))
        error = (yield from tracker.asking("TSTART:80")).error
        if error not in (None, WRONG_MODE):  # that: it tracks already
            raise self._refused("TSTART:80", error)
        family, wanted = prepared.identity.family, self._config.replies
        parsers = STRAY_PARSERS if self._config.strays else PARSERS
        for kind in family.replies if wanted == "auto" else (wanted,):
            error = (yield from tracker.asking(parsers[kind][0])).error
            if error is None:
                logger.info("%s: it tracks, and tells frames by %s", self.address, kind)
                tracker.stream = FrameStream(family.rate, kind, parsers, step)
                return
        raise self._refused("the question for frames", error)

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        prepared = self._tracker.prepared
        if prepared is not None and prepared.handles:
            return ()
        remedy = "Name tools in the configuration; 'crtk-driver ndi scan' shows those plugged in."
        text = "there is no tool to be tracked"
        return (TransitionFailed(text, where=self.address, remedy=remedy),)

    @override
    def disable(self) -> Steps:
        """Track no more."""
        self._tracker.stream = None
        error = (yield from self._tracker.asking("TSTOP:")).error
        if error not in (None, WRONG_MODE):
            raise self._refused("TSTOP:", error)

    @override
    def resume(self) -> Steps:
        """It has gone on tracking."""
        if self._tracker.stream is None:
            yield from self.enable()

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        return {"beep": Service("beep once", self._beep)}

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        summary = "how many tools have a pose"
        return {
            "tools_in_view": Reading(summary, Payload.NUMBER, self._in_view),
            "stray_markers": Reading(
                "how many markers belong to no tool", Payload.NUMBER, self._stray_markers
            ),
        }

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return self._tracker.counters

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        prepared, stream = self._tracker.prepared, self._tracker.stream
        if prepared is None:
            return ()
        absent = [name for at, name in enumerate(self._tools) if at not in prepared.handles]
        frame = stream.newest if stream is not None else None
        found = [
            (Severity.INFO, "tracker", self._product),
            (Severity.INFO, "plugged in", self._plugged),
            *((Severity.WARNING, "port", text) for text in prepared.problems),
            *((Severity.WARNING, "tool", f"{name} is not plugged in") for name in absent),
            *(
                (Severity.WARNING, "system", text)
                for text in told(frame.system if frame else 0, SYSTEM_STATUS)
            ),
        ]
        return tuple(Note(severity, key, text) for severity, key, text in found)

    @property
    def _product(self) -> str:
        prepared = self._tracker.prepared
        if prepared is None:
            return ""
        return " · ".join((prepared.identity.family.product, *prepared.identity.lines[1:3]))

    @property
    def _plugged(self) -> str:
        infos = self._tracker.prepared.infos if self._tracker.prepared is not None else {}
        return "; ".join(f"{handle:02X}: {info}" for handle, info in infos.items()) or "no tool"

    def _in_view(self) -> Number | None:
        stream = self._tracker.stream
        if stream is None or stream.newest is None:
            return None
        return Number(float(sum(t.values is not None for t in stream.newest.tools.values())))

    def _stray_markers(self) -> Number | None:
        stream = self._tracker.stream
        if stream is None or stream.newest is None or not self._config.strays:
            return None
        return Number(float(len(stream.newest.strays)))

    def _refused(self, what: str, code: int | None) -> TransitionFailed:
        return TransitionFailed(
            f"{what} was answered with {error_text(code or 0)}",
            where=self.address,
            remedy="Look at the tracker's own lights, and enable it again.",
        )

    def _beep(self) -> Answer:
        reply = yield from self._tracker.asking("BEEP:1")
        return "it beeped" if reply.text == "1" else f"it is busy, and did not ({reply.text})"
