"""Small motions: does it follow, arrive, repeat, and tell the truth about it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import BUSY, Acquisition, BenchTest, Safety, Subject
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.signals import fit_sine, noise, resolution, rest_time
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import (
    Z,
    exact,
    greatest,
    in_percent,
    mean,
    quantile,
    scaled,
    share,
    wider,
    within,
)
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Comparison,
    Findings,
    Measurement,
    Plot,
    Quantity,
    Worse,
)
from crtk_drivers.samples import Array, JointState, Pose, Vector, vector

FREQUENCIES: Final = {
    1.0: (1.0, 4.0),
    3.0: (0.5, 1.0, 2.0, 4.0, 8.0),
    10.0: (0.5, 1.0, 2.0, 4.0, 8.0),
}
"""Hz, by how thorough the run is."""

PERIODS: Final = 5
"""That are judged of each frequency; more, of the higher ones, in a run that takes its time."""

BEFORE: Final = 1.2
"""Periods before those: in the first it begins."""

TOO_SMALL: Final = "the amplitude is less than twenty steps of the encoder"

SHARE_OF_LIMITS: Final = 0.2
"""Share of the velocity and acceleration limits that a sine uses."""

STEPS: Final = 20.0
"""Steps of the encoder that an amplitude has at the least, else nothing is judged by it."""

STREAMS: Final = 4.0
"""Periods of a stream after a command in which it goes on."""

BUSY_ECHO: Final = 2e-3
"""The same, where single cycles of the device are judged."""

SETTLES: Final = 0.5
"""Seconds in which a joint is looked at after a move: longer than it may take to settle."""

STEP: Final = 0.5
"""Share of the reach of a small motion that one move goes."""

GAIN = Quantity.within("motion.bode.gain", "gain", "", 0.02)
PHASE = Quantity("motion.bode.phase", "phase", "deg", Comparison.TOLD, Worse.LOWER, 3.0)
ERROR = Quantity.told("motion.bode.error", "rms left over", "mrad or mm", 0.1)
LAG = Quantity.at_most("motion.lag.lag", "lag", "ms", 2.0)
SLOPE = Quantity.within(
    "joints.velocity.slope", "velocity over the derivative of position", "", 0.01
)
DELAY = Quantity.within("joints.velocity.delay", "velocity behind the derivative", "ms", 2.0)
FROZEN = Quantity.at_most(
    "sampling.frozen.share", "samples that repeat the one before in motion", "%", 1.0
)
SEEN = Quantity.at_least("motion.rate.seen", "commands whose stamp a setpoint carries", "%", 1.0)
ECHO = Quantity.at_most("motion.rate.age", "p99 from command to setpoint", "ms", 2.0)
ARRIVAL = Quantity.at_most("motion.arrival.error", "distance from the goal", "mrad or mm", 0.2)
OVERSHOOT = Quantity.at_most("motion.step.overshoot", "overshoot", "%", 0.3)
SETTLING = Quantity.at_most("motion.step.settling", "settling after the end of a move", "s", 0.02)
REPEATABILITY = Quantity.told(
    "motion.repeatability.encoder", "encoder repeatability, l + 3 S", "mrad or mm", 0.05
)
DIRECTION = Quantity.at_most(
    "motion.direction.distance", "between arrivals from both sides", "mrad or mm", 0.1
)
POSITION_AGREES = Quantity.at_most(
    "joints.kinematics.position", "measured pose off the kinematics", "mm", 0.02
)
TURN_AGREES = Quantity.at_most(
    "joints.kinematics.orientation", "measured orientation off the kinematics", "mrad", 0.05
)


# ------------------------------------------------------------------------------------------------ sines


def _amplitude(bed: Bed, frequency: float) -> Vector:
    """Return the amplitude of each joint (n,) that reach, velocity and acceleration allow."""
    omega = 2.0 * math.pi * frequency
    limits = bed.about.capabilities.limits
    allowed = [
        min(
            SHARE_OF_LIMITS * limit.velocity / omega,
            SHARE_OF_LIMITS * limit.acceleration / omega**2,
        )
        for limit in limits
    ]
    return vector(np.minimum(bed.reach(0.5), allowed))


def _wave(home: Vector, amplitude: Vector, frequency: float) -> Callable[[float], JointState]:
    """Return a sine that begins as a smooth swing: one that is there at once has a velocity at once."""
    omega = 2.0 * math.pi * frequency

    def wave(t: float) -> JointState:
        swell = 0.5 - 0.5 * math.cos(min(1.0, t * frequency) * math.pi)
        return JointState(position=home + amplitude * (swell * math.sin(omega * t)))

    return wave


def _sines(bed: Bed) -> None:
    bed.enable()
    home = bed.setpoint
    for frequency in FREQUENCIES[bed.thorough]:
        amplitude = _amplitude(bed, frequency)
        bed.note(**{f"amplitude {frequency:g}": amplitude.tolist()})
        bed.mark(f"begin {frequency:g}")
        periods = BEFORE + PERIODS * max(1.0, min(bed.thorough, frequency)) + 0.1
        bed.stream("servo_jp", _wave(home, amplitude, frequency), periods / frequency)
        bed.mark(f"end {frequency:g}")
        bed.rest(bed.about.silence + 0.1)
        bed.move_to(home)
    bed.note(frequencies=list(FREQUENCIES[bed.thorough]), stream_rate=bed.stream_rate)
    bed.disable()


SINES: Final = Acquisition(
    "sines",
    "Streams sines of all joints, at most 0.05 rad (10 mm) and a fifth of the limits.",
    Safety.SMALL,
    _sines,
    ("servo_jp", "move_jp", "measured_js"),
)


def _judged(trace: Trace, frequency: float) -> tuple[float, float]:
    """Return begin and end of the whole periods that are judged."""
    begin = trace.mark(f"begin {frequency:g}") + BEFORE / frequency
    return begin, trace.mark(f"end {frequency:g}")


def _windows(trace: Trace, frequency: float) -> list[tuple[float, float]]:
    begin, end = _judged(trace, frequency)
    count = max(1, int((end - begin) * frequency))
    return [(begin + index / frequency, begin + (index + 1) / frequency) for index in range(count)]


def _transfer(
    trace: Trace, frequency: float, column: int
) -> tuple[list[float], list[float], list[float]]:
    """Return gains, lags in s, and rms left over, of one joint: one a window."""
    joints = trace.joints.by_stamp
    at, position = trace.positions_sent("servo_jp")
    gains, lags, rests = [], [], []
    for begin, end in _windows(trace, frequency):
        part = joints.between(begin, end)
        sent = (at >= begin) & (at <= end)
        if part.at.size < 8 or sent.sum() < 8:
            continue
        asked = fit_sine(at[sent], position[sent][:, column], frequency)
        found = fit_sine(part.at, part.position[:, column], frequency)
        gains.append(found.amplitude / asked.amplitude)
        behind = (asked.phase - found.phase) % (2.0 * math.pi)
        if behind > 1.5 * math.pi:
            behind -= 2.0 * math.pi
        lags.append(behind / (2.0 * math.pi * frequency))
        rests.append(found.rms)
    return gains, lags, rests


def _moving(trace: Trace, frequency: float) -> list[int]:
    """Return the joints whose amplitude is more than some steps of their encoder."""
    amplitude = np.asarray(trace.notes[f"amplitude {frequency:g}"])
    steps = resolution(trace.joints.position)
    return [
        column
        for column in range(amplitude.size)
        if amplitude[column] >= max(STEPS * steps[column], 1e-9)
    ]


def _disturbed(trace: Trace, subject: Subject, allowed: float = BUSY) -> tuple[str, ...]:
    """Return why times are not judged: the bench was later than `allowed` s, or samples stayed away."""
    parts = [trace.joints.between(*_judged(trace, each)) for each in trace.notes["frequencies"]]
    gaps = (doubt for part in parts for doubt in subject.gaps(part.stamp))
    return (*subject.too_busy(allowed), *tuple(gaps)[:1])


def _bode(trace: Trace, subject: Subject) -> Findings:
    """Of each frequency the joint is told whose gain is furthest from 1."""
    found: list[Measurement] = []
    frequencies: list[float] = trace.notes["frequencies"]
    judged_at, gains_at, phases_at = [], [], []
    for frequency in frequencies:
        name = f"{frequency:g} Hz"
        columns = _moving(trace, frequency)
        transfers = {column: _transfer(trace, frequency, column) for column in columns}
        transfers = {column: each for column, each in transfers.items() if len(each[0]) > 1}
        if not transfers:
            why = "too few samples of it" if columns else TOO_SMALL
            found.append(subject.measured(GAIN, None, part=name, why=why))
            continue
        column = max(transfers, key=lambda each: abs(float(np.mean(transfers[each][0])) - 1.0))
        gains, lags, rests = transfers[column]
        part = f"{name} {subject.joints[column]}"
        gain, lag = mean(gains), mean(lags)
        judged_at.append(frequency)
        gains_at.append(gain.value)
        phases_at.append(-360.0 * frequency * lag.value)
        judged = Bound(1.1, "default, up to 1 Hz", 0.9) if frequency <= 1.0 else None
        found.append(subject.measured(GAIN, gain, judged, part=part))
        found.append(subject.measured(PHASE, scaled(lag, -360.0 * frequency), part=part))
        found.append(subject.measured(ERROR, scaled(mean(rests), 1e3), part=part))
    return Findings(
        tuple(found),
        doubts=_disturbed(trace, subject),
        plots=(
            Plot.of("Gain", "Hz", "", ("", judged_at, gains_at)),
            Plot.of("Phase", "Hz", "deg", ("", judged_at, phases_at)),
            _following_plot(trace, frequencies[-1]),
        ),
    )


def _following_plot(trace: Trace, frequency: float) -> Plot:
    begin, end = _judged(trace, frequency)
    column = int(np.argmax(trace.notes[f"amplitude {frequency:g}"]))
    at, position = trace.positions_sent("servo_jp")
    joints = trace.joints.by_stamp.between(begin, end)
    sent = (at >= begin) & (at <= end)
    middle = position[sent][:, column].mean() if sent.any() else 0.0
    return Plot.of(
        f"{frequency:g} Hz: asked and measured",
        "time, s",
        "mrad or mm",
        ("asked", at[sent], 1e3 * (position[sent][:, column] - middle)),
        ("measured", joints.at, 1e3 * (joints.position[:, column] - middle)),
    )


def _lag(trace: Trace, subject: Subject) -> Findings:
    slow = [frequency for frequency in trace.notes["frequencies"] if frequency <= 1.0]
    lags: dict[int, list[float]] = {}
    for frequency in slow:
        for column in _moving(trace, frequency):
            lags.setdefault(column, []).extend(_transfer(trace, frequency, column)[1])
    sound = {column: found for column, found in lags.items() if len(found) > 1}
    if not sound:
        return Findings(doubts=("too few samples" if lags else TOO_SMALL,))
    worst = max(sound, key=lambda column: float(np.mean(sound[column])))
    held = 1.0 / trace.notes["stream_rate"]
    allowed = subject.lag + 3.0 * subject.period + held
    bound = Bound(1e3 * allowed, "the declared lag, three periods and one of the stream")
    found = subject.measured(
        LAG, scaled(mean(sound[worst]), 1e3), bound, part=subject.joints[worst]
    )
    return Findings((found,), doubts=_disturbed(trace, subject))


def _velocity(trace: Trace, subject: Subject) -> Findings:
    joints = trace.joints.by_stamp
    names = subject.joints
    frequency = max(trace.notes["frequencies"], key=lambda f: -abs(f - 1.0))
    amplitude = np.asarray(trace.notes[f"amplitude {frequency:g}"])
    steps = resolution(joints.position)
    found: list[Measurement] = []
    for column, name in enumerate(names):
        if amplitude[column] < STEPS * steps[column]:
            found.append(
                subject.measured(
                    SLOPE, None, part=name, why="it moves less than twenty steps of its encoder"
                )
            )
            continue
        slopes, delays, doubts = [], [], []
        for begin, end in _windows(trace, frequency):
            part = joints.between(begin, end)
            if part.at.size < 8 or not np.isfinite(part.velocity[:, column]).all():
                continue
            position = fit_sine(part.at, part.position[:, column], frequency)
            velocity = fit_sine(part.at, part.velocity[:, column], frequency)
            omega = 2.0 * math.pi * frequency
            slopes.append(velocity.amplitude / (omega * position.amplitude))
            left = velocity.rms * math.sqrt(2.0 / part.at.size)
            doubts.append(Z * left / (omega * position.amplitude))
            ahead = (velocity.phase - position.phase - 0.5 * math.pi + math.pi) % (2.0 * math.pi)
            delays.append((math.pi - ahead) / omega)
        if len(slopes) < 2:
            found.append(subject.measured(SLOPE, None, part=name, why="no velocities, or too few"))
            continue
        # A stream that a device follows in steps has velocities in step with it, the same in each window.
        slope = wider(mean(slopes), max(doubts))
        found.append(subject.measured(SLOPE, slope, Bound(1.02, "default", 0.98), part=name))
        room = 1e3 * max(0.02, 3.0 * subject.period)
        found.append(
            subject.measured(
                DELAY,
                scaled(mean(delays), 1e3),
                Bound(room, "20 ms, or three periods", -room),
                part=name,
            )
        )
    return Findings(tuple(found), doubts=_disturbed(trace, subject))


def _frozen(trace: Trace, subject: Subject) -> Findings:
    frequency = max(trace.notes["frequencies"], key=lambda f: -abs(f - 1.0))
    begin, end = _judged(trace, frequency)
    joints = trace.joints.by_stamp.between(begin, end)
    steps = resolution(joints.position)
    amplitude = np.asarray(trace.notes[f"amplitude {frequency:g}"])
    # Where even the slowest of it would show: the middle of the swing, at over five steps a sample.
    speed = 2.0 * math.pi * frequency * amplitude * 0.7
    column = int(np.argmax(speed / np.maximum(steps, 1e-9)))
    if speed[column] * subject.period < 5.0 * steps[column]:
        return Findings(doubts=("it moves less than five steps of its encoder in a sample",))
    middle = joints.position[:, column].mean()
    in_swing = np.abs(joints.position[1:, column] - middle) < 0.7 * amplitude[column]
    sent = np.array([at for at, *_ in trace.commands("servo_jp")])
    if sent.size:  # where the bench itself stood still, so did the arm
        last = sent[np.maximum(np.searchsorted(sent, joints.at[1:]) - 1, 0)]
        in_swing &= joints.at[1:] - last < STREAMS / trace.notes["stream_rate"]
    repeats = (np.diff(joints.position, axis=0) == 0.0).all(axis=1)
    count = int(in_swing.sum())
    if count < 50:
        return Findings(doubts=(f"{count} samples in motion",))
    found = share(int((repeats & in_swing).sum()), count)
    return Findings(
        (subject.measured(FROZEN, in_percent(found), Bound(5.0, "default")),),
        doubts=_disturbed(trace, subject),
    )


def _effective_rate(trace: Trace, subject: Subject) -> Findings:
    sent = {round(stamp, 6): at for at, stamp, _ in trace.commands("servo_jp")}
    setpoints = trace.joint_states("setpoint_js")
    seen: dict[float, float] = {}
    for at, stamp in zip(setpoints.at, setpoints.stamp, strict=True):
        key = round(float(stamp), 6)
        if key in sent:
            seen.setdefault(key, float(at))
    if len(sent) < 20:
        return Findings(doubts=(f"{len(sent)} commands",))
    if not seen:
        return Findings(doubts=("its setpoints do not carry the stamps of commands",))
    ages = [1e3 * (at - sent[key]) for key, at in seen.items()]
    return Findings(
        (
            subject.measured(SEEN, in_percent(share(len(seen), len(sent))), Bound(97.0, "default")),
            subject.measured(
                ECHO,
                quantile(ages, 0.99),
                Bound(3e3 * subject.period + 2.0, "three periods and 2 ms"),
            ),
        ),
        doubts=(
            *_disturbed(trace, subject, BUSY_ECHO),
            *subject.uneven(trace.joints.stamp),
        ),
    )


# -------------------------------------------------------------------------------------------- approaches


def _approaches(bed: Bed) -> None:
    bed.enable()
    home = bed.setpoint
    step = bed.reach(STEP)
    bed.note(goal=home.tolist(), step=step.tolist())
    bed.rest(SETTLES)
    bed.mark("rest")
    for index in range(int(4 * bed.thorough)):
        for side, name in ((-1.0, "below"), (1.0, "above")):
            if name == "above" and index >= int(3 * bed.thorough):
                continue
            bed.move_to(vector(home + side * step))
            bed.mark(f"leave {name}")
            bed.move_to(home)
            bed.mark(f"planned {name}")
            bed.rest(SETTLES)
            bed.mark(f"there {name}")
    if bed.about.has_kinematics:
        _look_at_poses(bed)
    bed.disable()


def _look_at_poses(bed: Bed) -> None:
    """Write down measured poses and what the kinematics say of the same joints."""
    pairs = []
    for _ in range(3):
        values = bed.glance().values
        joints, _ = values["measured_js"]
        pose, _ = values.get("measured_cp", (None, None))
        if not (isinstance(pose, Pose) and isinstance(joints, JointState)):
            return
        expected = bed.forward(joints.position)
        if expected is not None:
            pairs.append(
                [
                    *(pose.position.tolist(), pose.orientation.tolist()),
                    *(expected.position.tolist(), expected.orientation.tolist()),
                ]
            )
        bed.rest(0.05)
    bed.note(poses=pairs)


APPROACHES: Final = Acquisition(
    "approaches",
    "Moves to where it is, again and again, from either side, by at most 0.05 rad (10 mm).",
    Safety.SMALL,
    _approaches,
    ("move_jp", "measured_js"),
)


def _ends(trace: Trace, side: str) -> Array:
    """Return where the joints were (k, n) at each arrival from a side: the mean of the last 0.1 s."""
    joints = trace.joints
    return np.array(
        [joints.between(at - 0.1, at).position.mean(axis=0) for at in trace.marks(f"there {side}")]
    )


def _arrives(trace: Trace, subject: Subject) -> Findings:
    goal = np.asarray(trace.notes["goal"])
    steps = resolution(trace.joints.position)
    ends = np.concatenate([_ends(trace, "below"), _ends(trace, "above")])
    errors = np.abs(ends - goal)
    allowed = np.maximum(2.0 * steps, 1e-3)
    worst = int(np.argmax(errors.mean(axis=0) / allowed))
    bound = Bound(1e3 * float(allowed[worst]), "two steps of its encoder, or 1 mrad")
    error = scaled(mean(errors[:, worst]), 1e3)
    found = subject.measured(ARRIVAL, error, bound, part=subject.joints[worst])
    return Findings((found,))


def _step(trace: Trace, subject: Subject) -> Findings:
    joints = trace.joints
    step = np.asarray(trace.notes["step"])
    goal = np.asarray(trace.notes["goal"])
    resolved = resolution(joints.position)
    rest = trace.mark("rest")
    rough = np.maximum(3.0 * noise(joints.between(rest - SETTLES, rest).position), resolved)
    sizes = np.maximum(step, 1e-9)
    tolerance = np.maximum(rough, 0.01 * sizes)
    overshoots, settlings = [], []
    for side, sign in (("below", 1.0), ("above", -1.0)):
        starts = zip(
            *(trace.marks(f"{word} {side}") for word in ("leave", "planned", "there")), strict=True
        )
        for leave, planned, there in starts:
            part = joints.between(leave, there)
            beyond = (sign * (part.position - goal)).max(axis=0)
            overshoots.append(100.0 * np.maximum(beyond, 0.0) / sizes)
            settlings.append(rest_time(part.at, part.position, planned, tolerance))
    allowed = np.maximum(1.0, 200.0 * rough / sizes)
    column = int(np.argmax(np.mean(overshoots, axis=0) / allowed))
    worst = greatest(settlings).value
    return Findings(
        (
            subject.measured(
                OVERSHOOT,
                mean([each[column] for each in overshoots]),
                Bound(float(allowed[column]), "1 %, or two steps of its encoder"),
                part=subject.joints[column],
            ),
            subject.measured(
                SETTLING, within(worst, subject.period, len(settlings)), Bound(0.3, "default")
            ),
        ),
        plots=(
            Plot.of(
                "Arrivals, from the goal",
                "time, s",
                "mrad or mm",
                (
                    subject.joints[column],
                    joints.at,
                    1e3 * (joints.position[:, column] - goal[column]),
                ),
            ),
        ),
    )


def _repeats(trace: Trace, subject: Subject) -> Findings:
    ends = _ends(trace, "below")
    distances = np.linalg.norm(ends - ends.mean(axis=0), axis=1)
    value = float(distances.mean() + 3.0 * distances.std(ddof=1))
    found = subject.measured(
        REPEATABILITY,
        exact(1e3 * value, len(ends)),
        why=f"{len(ends)} arrivals, by its own encoders",
    )
    return Findings((found,))


def _direction(trace: Trace, subject: Subject) -> Findings:
    below, above = _ends(trace, "below"), _ends(trace, "above")
    apart = np.abs(below.mean(axis=0) - above.mean(axis=0))
    spread = np.sqrt(
        below.var(axis=0, ddof=1) / len(below) + above.var(axis=0, ddof=1) / len(above)
    )
    allowed = np.maximum(3.0 * resolution(trace.joints.position), 1e-3)
    found = subject.furthest(
        DIRECTION,
        apart,
        allowed,
        "three steps of its encoder, or 1 mrad",
        doubts=2.0 * spread,
        n=len(below) + len(above),
    )
    return Findings((found,))


def _kinematics(trace: Trace, subject: Subject) -> Findings:
    pairs = trace.notes.get("poses", [])
    if not pairs:
        return Findings(doubts=("no poses were measured",))
    distances, angles = [], []
    for position, orientation, expected, turned in pairs:
        distances.append(1e3 * math.dist(position, expected))
        cosine = min(1.0, abs(float(np.dot(orientation, turned))))
        angles.append(2e3 * math.acos(cosine))
    return Findings(
        (
            subject.measured(
                POSITION_AGREES, exact(max(distances), len(pairs)), Bound(0.1, "default")
            ),
            subject.measured(TURN_AGREES, exact(max(angles), len(pairs)), Bound(0.2, "default")),
        )
    )


TESTS: Final = (
    BenchTest("J3", "velocity is true", "joints", SINES, _velocity, (SLOPE, DELAY)),
    BenchTest("T5", "frozen", "sampling", SINES, _frozen, (FROZEN,)),
    BenchTest("M4", "frequency response", "motion", SINES, _bode, (GAIN, PHASE, ERROR)),
    BenchTest("M5", "lag", "motion", SINES, _lag, (LAG,)),
    BenchTest(
        "M7", "effective rate", "motion", SINES, _effective_rate, (SEEN, ECHO), ("setpoint_js",)
    ),
    BenchTest("M2", "arrives", "motion", APPROACHES, _arrives, (ARRIVAL,)),
    BenchTest("M3", "step", "motion", APPROACHES, _step, (OVERSHOOT, SETTLING)),
    BenchTest("M8", "encoder repeatability", "motion", APPROACHES, _repeats, (REPEATABILITY,)),
    BenchTest("M10", "direction", "motion", APPROACHES, _direction, (DIRECTION,)),
    BenchTest(
        "J4",
        "kinematics agree",
        "joints",
        APPROACHES,
        _kinematics,
        (POSITION_AGREES, TURN_AGREES),
        ("measured_cp",),
    ),
)
