"""Trials for which somebody pushes the device: what is done by hand stays done."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from crtk_drivers.client.conformance.findings import (
    Finding,
    conforms,
    diverges,
    not_offered,
    undetermined,
)
from crtk_drivers.client.conformance.trial import Trial, far

PUSHED: Final = 0.02
"""rad or m by which a joint has been moved by hand."""
PERSON_TAKES: Final = 30.0
"""Seconds in which somebody moves a joint, once asked."""
LET_GO: Final = 5.0
"""Seconds after which it stands where it was left: a hand does not hold it still."""


def pushed_in_disabled(trial: Trial) -> None:
    """MOV-3."""
    if trial.leave.ask is None:
        return
    if trial.word() != "DISABLED" and not trial.reach("disable", "DISABLED"):
        trial.note("MOV-3", undetermined(f"it stays {trial.word()} after disable"))
        return
    if _pushed(trial, "while it is DISABLED"):
        trial.note("MOV-3", _enabled_where_it_is(trial))
    else:
        trial.note("MOV-3", undetermined("nobody moved it: its brakes may hold while DISABLED"))


def pushed_in_free(trial: Trial) -> None:
    """MOV-23, and MOV-3 of a device whose brakes hold while it is DISABLED."""
    if trial.leave.ask is None:
        return
    if not trial.offers("free"):
        trial.note("MOV-23", not_offered("no free"))
        return
    trial.enable()
    before = trial.here()
    trial.probe.send("free")
    if not _pushed(trial, "in free"):
        trial.note("MOV-23", undetermined("nobody moved it in free, or it cannot be moved"))
        trial.hold()
        return
    trial.note("MOV-23", _stays(trial, before))
    trial.hold()
    if trial.reach("disable", "DISABLED"):
        trial.note("MOV-3", _enabled_where_it_is(trial))


def _pushed(trial: Trial, when: str) -> bool:
    """Ask for a push, and return whether it came; the joints have been let go then."""
    assert trial.leave.ask is not None
    before = trial.here()
    trial.leave.ask(
        f"move a joint by hand {when}, by {10.0 * PUSHED:g} rad or m, and let go: "
        f"within {PERSON_TAKES:g} s"
    )
    moved = trial.probe.wait(lambda: far(trial.here(), before) > PUSHED, PERSON_TAKES)
    if moved:
        trial.probe.sleep(LET_GO)
    return moved


def _stays(trial: Trial, before: Sequence[float]) -> Finding:
    """Return whether it is still where it was pushed to from `before`."""
    away = far(trial.here(), before)
    if away > 0.5 * PUSHED:
        return conforms(f"it lets go: pushed by {away:.3f}, and stays there")
    return diverges(f"it goes back when it is let go: {away:.1e} from where it was")


def _enabled_where_it_is(trial: Trial) -> Finding:
    """Enable it, and return whether it holds where it is now: not while somebody has it in hand."""
    if not trial.at_rest():
        return undetermined("it was not let go in time: it still moved")
    pushed_to = trial.here()
    trial.enable()
    trial.settle(2.0 * trial.expected.wait)
    off = far(trial.here(), pushed_to)
    if off > max(trial.still, trial.expected.arrival):
        return diverges(f"enable moves it by {off:.4f} from where it was pushed to")
    return conforms(f"enabled where it was pushed to ({off:.1e})")
