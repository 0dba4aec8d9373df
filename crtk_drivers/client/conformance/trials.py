"""All trials, in their order: what must move nothing comes first, and ends them if it moves something."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from crtk_drivers.client.conformance import (
    change_trials,
    client_trials,
    hand_trials,
    move_trials,
    state_trials,
    stream_trials,
)
from crtk_drivers.client.conformance.findings import (
    Finding,
    Verdict,
    conforms,
    diverges,
    undetermined,
)
from crtk_drivers.client.conformance.trial import Stopped, Trial


@dataclass(frozen=True, slots=True)
class Step:
    """A trial, and the clauses that it decides."""

    run: Callable[[Trial], None]
    clauses: tuple[str, ...]
    is_motion: bool = True


STEPS: Final = (
    Step(
        state_trials.in_disabled,
        ("STA-6", "STA-12", "STA-14", "RAT-2", "MOV-1"),
        is_motion=False,
    ),
    Step(state_trials.jaw_in_disabled, ("SUB-2",), is_motion=False),
    Step(state_trials.enabling, ("STA-5", "MOV-2", "SPT-9"), is_motion=False),
    Step(state_trials.in_enabled, ("STA-7", "STA-8", "MOV-1", "MOV-2"), is_motion=False),
    Step(
        state_trials.bad_input,
        ("INP-1", "INP-2", "INP-3", "INP-4", "INP-5", "INP-6", "INP-8", "INP-9"),
        is_motion=False,
    ),
    Step(
        stream_trials.positions,
        (
            *("MOV-4", "MOV-5", "MOV-6", "DAT-2", "DAT-12", "DAT-13", "DAT-15", "DAT-18"),
            *("DAT-22", "SUB-1", "SPT-1", "SPT-2", "SPT-8", "BSY-4"),
        ),
    ),
    Step(stream_trials.names_in_another_order, ("MOV-7",)),
    Step(stream_trials.increments, ("MOV-11", "QOS-6")),
    Step(stream_trials.velocities, ("MOV-12", "MOV-13", "MOV-14", "SPT-3", "SPT-5", "DAT-11")),
    Step(stream_trials.poses, ("MOV-8", "MOV-9", "SPT-7")),
    Step(stream_trials.relative_poses, ("MOV-10",)),
    Step(move_trials.arrives, ("MOV-16", "BSY-2", "GOL-1", "SPT-6")),
    Step(move_trials.to_where_it_is, ("BSY-3",)),
    Step(move_trials.pre_empted, ("MOV-18",)),
    Step(move_trials.held, ("MOV-22", "BSY-5")),
    Step(move_trials.disabled_on_the_way, ("STA-13",)),
    Step(move_trials.relative_moves, ("MOV-19",)),
    Step(move_trials.poses, ("MOV-17",)),
    Step(move_trials.refused_goal, ("GOL-2",)),
    Step(move_trials.dead_topics, ("SET-1",)),
    Step(change_trials.first_command, ("STA-11",)),
    Step(change_trials.burst, ("QOS-5",)),
    Step(change_trials.flood, ("INP-7",)),
    Step(change_trials.far_step, ("MOV-15",)),
    Step(change_trials.interpolated, ("MOV-20",)),
    Step(change_trials.changes_of_kind, ("MOV-21",)),
    Step(change_trials.two_clients, ("MOV-25",)),
    Step(change_trials.slower_moves, ("MOV-24",)),
    Step(change_trials.efforts, ("SPT-4",)),
    Step(client_trials.opening, ("CLI-1",)),
    Step(state_trials.homing, ("HOM-2",)),
    Step(hand_trials.pushed_in_disabled, ("MOV-3",), is_motion=False),
    Step(hand_trials.pushed_in_free, ("MOV-23", "MOV-3"), is_motion=False),
)
"""``STA-9`` comes before them, in a device that is found in FAULT; ``STA-10`` is decided by all of them."""

HEARD_BELOW: Final = (
    *("body/measured_cv", "spatial/measured_cv", "trajectory_j/ratio"),
    *(f"{jaw}/measured_js" for jaw in state_trials.JAWS),
)
"""Names in sub-namespaces that trials need."""

MOST_LATE: Final = 0.02
"""Seconds that a stream of this tool may be late: a period of it."""
TOO_LATE: Final = "this machine was late by"

TRIED: Final = frozenset(
    {"STA-9", "STA-10", *(clause for step in STEPS for clause in step.clauses)}
)


def chosen_steps(ids: Collection[str]) -> tuple[Step, ...]:
    """Return the steps that decide any of the clauses `ids`."""
    return tuple(
        step for step in STEPS if "STA-10" in ids or any(clause in ids for clause in step.clauses)
    )


UNHEARD: Final = 0.3
"""Seconds in which an enable is heard of that was sent just before the trials were interrupted."""


def run_trials(
    trial: Trial, ids: Collection[str], tell: Callable[[str], None]
) -> tuple[Mapping[str, Sequence[Finding]], str]:
    """Carry out the trials of some clauses, and bring the device back to the state it was in.

    Args:
        trial: of the device.
        ids: of clauses.
        tell: called with what is being tried.

    Returns:
        Findings by clause, and why the trials ended early, empty if they did not.
    """
    before, why = trial.word(), ""
    if before not in ("DISABLED", "ENABLED", "PAUSED", "FAULT"):
        return {}, f"it is {before or 'silent'}: nothing can be tried"
    if not trial.offers("state_command", "measured_js"):
        return {}, "it has no state_command, or no measured_js to see motion by"
    try:
        if before == "FAULT":
            tell("trying STA-9")
            state_trials.in_fault(trial)
        for step in chosen_steps(ids):
            tell(f"trying {', '.join(step.clauses)}")
            if step.is_motion:
                trial.enable()
            began, known = trial.probe.now(), {each: len(f) for each, f in trial.found.items()}
            trial.probe.lateness()
            try:
                step.run(trial)
            finally:
                if step.is_motion:
                    excuse(trial, known, trial.probe.lateness())
                _no_fault(trial, began)
            trial.probe.forget()
    except Stopped as stopped:
        why = str(stopped)
    finally:
        tell("bringing it back")
        leave_as_found(trial, before)
    return trial.found, why


def excuse(trial: Trial, known: Mapping[str, int], late: float) -> None:
    """Leave open what diverged in a motion while this tool itself was late: it may be why.

    Args:
        trial: with its findings.
        known: how many findings each clause had before.
        late: how late this tool was, in s.
    """
    if late <= MOST_LATE:
        return
    for clause, findings in trial.found.items():
        for index in range(known.get(clause, 0), len(findings)):
            if findings[index].verdict is Verdict.DIVERGES:
                findings[index] = undetermined(
                    f"{TOO_LATE} {1e3 * late:.0f} ms: {findings[index].text}"
                )


def _no_fault(trial: Trial, began: float) -> None:
    """STA-10."""
    trace = trial.probe.trace(began)
    if any(each.state == "FAULT" for each in trace.states):
        trial.note("STA-10", diverges("it went to FAULT", [text for _, text in trace.told]))
        raise Stopped("it is in FAULT")
    trial.note("STA-10", conforms("never in FAULT"))


def leave_as_found(trial: Trial, state: str) -> None:
    """Hold the device, and bring it to a state."""
    trial.hold()
    if trial.word() in ("", "FAULT"):
        return
    if state in ("DISABLED", "FAULT"):
        trial.probe.send("state_command", text="disable")
        trial.settle(UNHEARD)
        trial.probe.wait(lambda: trial.word() == "DISABLED", trial.expected.transition_time)
        return
    try:
        trial.enable()
    except Stopped:
        return
    if state == "PAUSED":
        trial.reach("pause", "PAUSED")
