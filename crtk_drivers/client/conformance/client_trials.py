"""A trial with the official Python client, which does what its users do first."""

from __future__ import annotations

from crtk_drivers.client.conformance.findings import conforms, diverges, undetermined
from crtk_drivers.client.conformance.trial import Opening, Trial

NOT_INSTALLED = (
    "the official client (crtk, with PyKDL) is not installed here; with the same calls of this "
    "project's layer in place of it"
)


def opening(trial: Trial) -> None:
    """CLI-1."""
    needed = ("state_command", "operating_state", "measured_js", "move_jp")
    if trial.lacks(needed, "CLI-1"):
        return
    if trial.client is None:
        trial.note("CLI-1", undetermined("there is no client to try it with"))
        return
    if not (trial.is_homed or trial.leave.may_home):
        trial.note("CLI-1", undetermined("it is not homed, and needs --may-home"))
        return
    begin, times = trial.here(), trial.expected
    goal = trial.away(times.step)
    longest = max(times.transition_time, times.move_time)
    told = trial.client(Opening(goal, begin, longest, times.home_time, times.arrival))
    trial.at_rest()
    works = f"{', '.join(told.done) or 'nothing'} worked"
    words = f"{works}; {told.failed}" if told.failed else works
    if not told.is_official:
        trial.note("CLI-1", undetermined(f"{NOT_INSTALLED}: {words}"))
    elif told.failed:
        trial.note("CLI-1", diverges(words))
    else:
        trial.note("CLI-1", conforms(words))
