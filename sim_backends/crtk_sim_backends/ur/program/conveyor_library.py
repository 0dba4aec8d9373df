"""The URScript built-ins for encoders, conveyors that moves track, and offsets of the path.

Names, parameters and defaults follow the URScript manual, chapter "motion"; the functions of before
encoder 1 are those of manual 3.0 and mean encoder 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

from crtk_sim_backends.ur.motion.control import Motion, MotionControl
from crtk_sim_backends.ur.motion.kinematics import norm, to_pose, to_transform
from crtk_sim_backends.ur.motion.superposition import (
    CircularConveyor,
    Conveyor,
    LinearConveyor,
    OffsetFrame,
)
from crtk_sim_backends.ur.signals.encoders import COUNT, RANGES, Encoder, Encoders
from crtk_sim_backends.ur.urscript import Builtin, Pose, ScriptRuntimeError
from crtk_sim_backends.ur.urscript.arguments import positive, six, vector

_STOPPING: Final = 20.0  # rad/s^2
_QUADRATURE: Final = 1
_DECODERS: Final = range(5)
_OLD_PINS: Final = range(4)
_PINS: Final = range(8, 12)

Call = Callable[..., Any]


def conveyor_builtins(encoders: Encoders, control: MotionControl) -> Iterator[Builtin]:
    """Every built-in of this module for one controller."""
    for call in (*_encoders(encoders), *_tracking(encoders, control), *_path_offset(control)):
        yield Builtin(call.__name__, call)
    for call in (_stop_tracking(control), _disable_offset(control)):
        yield Builtin(call.__name__, call, blocking=True)


def _chosen(name: str, what: str, value: Any, choices: range) -> int:
    if not isinstance(value, (int, float)) or value not in choices:
        raise ScriptRuntimeError(
            f"{name}: {what} lies in {choices[0]} to {choices[-1]}, not {value}"
        )
    return int(value)


def _encoder(encoders: Encoders, name: str, index: Any) -> Encoder:
    return encoders[_chosen(name, "encoder_index", index, range(COUNT))]


def _encoders(encoders: Encoders) -> list[Call]:
    def decode(name: str, encoder: Encoder, kind: Any, pins: range, *used: Any) -> None:
        decoder = _chosen(name, "the type of decoder", kind, _DECODERS)
        if not decoder:
            encoder.disable()
            return
        for pin in used if decoder == _QUADRATURE else used[:1]:
            _chosen(name, "a digital input", pin, pins)
        encoder.count_pulses(has_direction=decoder == _QUADRATURE)

    def take(name: str, encoder: Encoder, range_id: Any) -> None:
        encoder.take_counts(RANGES[_chosen(name, "range_id", range_id, range(len(RANGES)))])

    def put(name: str, encoder: Encoder, count: Any) -> None:
        if not encoder.accepts_counts:
            raise ScriptRuntimeError(f"{name}: the encoder is not enabled to have its count set")
        if not isinstance(count, (int, float)) or not encoder.set_count(int(count)):
            raise ScriptRuntimeError(f"{name}: {count} is not within the range of the encoder")

    def encoder_enable_pulse_decode(
        encoder_index: int,
        decoder_type: int,
        A: int = 8,  # noqa: N803
        B: int = 9,  # noqa: N803
    ) -> None:
        name = "encoder_enable_pulse_decode"
        decode(name, _encoder(encoders, name, encoder_index), decoder_type, _PINS, A, B)

    def encoder_enable_set_tick_count(encoder_index: int, range_id: int) -> None:
        name = "encoder_enable_set_tick_count"
        take(name, _encoder(encoders, name, encoder_index), range_id)

    def encoder_set_tick_count(encoder_index: int, count: int) -> None:
        name = "encoder_set_tick_count"
        put(name, _encoder(encoders, name, encoder_index), count)

    def encoder_get_tick_count(encoder_index: int, opt: str = "") -> float:
        name = "encoder_get_tick_count"
        encoder = _encoder(encoders, name, encoder_index)
        if opt not in ("", "raw"):
            raise ScriptRuntimeError(f"{name}: no option {opt}")
        return encoder.raw if opt else encoder.filtered

    def encoder_unwind_delta_tick_count(
        encoder_index: int, delta_tick_count: float
    ) -> float | None:
        """Difference of two counts over the end of the range; nothing for an encoder that is off."""
        name = "encoder_unwind_delta_tick_count"
        encoder = _encoder(encoders, name, encoder_index)
        return encoder.unwound(delta_tick_count) if encoder.enabled else None

    def conveyor_pulse_decode(type: int, A: int = 0, B: int = 1) -> None:  # noqa: N803
        decode("conveyor_pulse_decode", encoders[0], type, _OLD_PINS, A, B)

    def set_conveyor_tick_count(tick_count: int, absolute_encoder_resolution: int = 0) -> None:
        name = "set_conveyor_tick_count"
        if not encoders[0].accepts_counts:
            take(name, encoders[0], absolute_encoder_resolution)
        put(name, encoders[0], tick_count)

    def get_conveyor_tick_count() -> float:
        return encoders[0].filtered

    return [
        encoder_enable_pulse_decode,
        encoder_enable_set_tick_count,
        encoder_set_tick_count,
        encoder_get_tick_count,
        encoder_unwind_delta_tick_count,
        conveyor_pulse_decode,
        set_conveyor_tick_count,
        get_conveyor_tick_count,
    ]


def _tracking(encoders: Encoders, control: MotionControl) -> list[Call]:
    superposition = control.plant.superposition

    def start(name: str, conveyor: Conveyor) -> None:
        if superposition.source is superposition.path_offset:
            raise ScriptRuntimeError(f"{name}: an offset of the path is enabled")
        superposition.start(conveyor)

    def track_conveyor_linear(
        direction: Any, ticks_per_meter: float, encoder_index: int = 0
    ) -> None:
        name = "track_conveyor_linear"
        way = vector(f"{name} direction", direction, 3)
        size = norm(way)
        if size < 1e-9:
            raise ScriptRuntimeError(f"{name}: the direction {direction} is none")
        ticks = _ticks(name, ticks_per_meter)
        encoder = _encoder(encoders, name, encoder_index)
        start(name, LinearConveyor(encoder, ticks, [x / size for x in way]))

    def track_conveyor_circular(
        center: Any,
        ticks_per_revolution: float,
        rotate_tool: bool = False,
        encoder_index: int = 0,
    ) -> None:
        name = "track_conveyor_circular"
        centre = to_transform(six(f"{name} center", center))
        ticks = _ticks(name, ticks_per_revolution)
        encoder = _encoder(encoders, name, encoder_index)
        start(name, CircularConveyor(encoder, ticks, centre, bool(rotate_tool)))

    return [track_conveyor_linear, track_conveyor_circular]


def _ticks(name: str, value: Any) -> float:
    """Check how many ticks there are; fewer than none count backwards."""
    if not isinstance(value, (int, float)) or not 1e-3 <= abs(value) <= 1e12:
        raise ScriptRuntimeError(f"{name}: expected a number of ticks, got {value}")
    return float(value)


def _stop_tracking(control: MotionControl) -> Call:
    superposition = control.plant.superposition

    def stop_conveyor_tracking(a: float = _STOPPING) -> Motion:
        deceleration = positive("stop_conveyor_tracking a", a)
        if isinstance(superposition.source, Conveyor):
            superposition.end(deceleration)
        yield from control.halt(deceleration)

    return stop_conveyor_tracking


def _path_offset(control: MotionControl) -> list[Call]:
    plant = control.plant
    superposition, applied = plant.superposition, plant.superposition.path_offset

    def frame(name: str, type: Any) -> OffsetFrame:
        return OffsetFrame(_chosen(name, "type", type, range(1, len(OffsetFrame) + 1)))

    def path_offset_enable() -> None:
        source = superposition.source
        if source is applied:
            return
        if source is not None:
            raise ScriptRuntimeError("path_offset_enable: a conveyor is tracked")
        applied.begin()
        superposition.start(applied)

    def path_offset_set(offset: Any, type: int) -> None:
        wanted = six("path_offset_set offset", offset)
        applied.frame = frame("path_offset_set", type)
        applied.wanted = wanted

    def path_offset_get(type: int) -> Pose:
        axes = frame("path_offset_get", type)
        if superposition.source is not applied:
            return Pose([0.0] * 6)
        path, tool = superposition.poses(plant.tool)
        between = applied.between(path, tool, axes, lambda: superposition.motion_frame(plant.tool))
        return Pose(to_pose(between))

    def path_offset_set_alpha_filter(alpha: float) -> None:
        if not isinstance(alpha, (int, float)) or not 0.0 <= alpha <= 1.0:
            raise ScriptRuntimeError(f"path_offset_set_alpha_filter: {alpha} is not within 0 to 1")
        applied.alpha = float(alpha)

    def path_offset_set_max_offset(transLimit: float, rotLimit: float) -> None:  # noqa: N803
        name = "path_offset_set_max_offset"
        applied.limits = (
            positive(f"{name} transLimit", transLimit),
            positive(f"{name} rotLimit", rotLimit),
        )

    return [
        path_offset_enable,
        path_offset_set,
        path_offset_get,
        path_offset_set_alpha_filter,
        path_offset_set_max_offset,
    ]


def _disable_offset(control: MotionControl) -> Call:
    superposition = control.plant.superposition

    def path_offset_disable(a: float = _STOPPING) -> Motion:
        deceleration = positive("path_offset_disable a", a)
        if superposition.source is superposition.path_offset:
            superposition.end(deceleration)
        yield from control.halt(deceleration)

    return path_offset_disable
