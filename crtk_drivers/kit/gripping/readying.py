"""What makes a gripper ready may drop what it holds: when that is done, and when not."""

from __future__ import annotations

from crtk_drivers.errors import CrtkError, TransitionFailed

__all__ = ["not_made_ready"]


def not_made_ready(
    what: str, policy: str, service: str, *, may_hold: bool, where: str, verb: str
) -> tuple[CrtkError, ...]:
    """Return why it is not made ready by `enable`: that is not wanted, or would drop something.

    Args:
        what: why it is not ready.
        policy: ``never``, or another.
        service: by which it is made ready by name.
        may_hold: it may hold something.
        where: for messages.
        verb: what it would be to make it ready: ``activate it``.
    """
    if policy == "never":
        remedy = f"Have it done at its pendant or page, or use {service}."
        return (TransitionFailed(what, where=where, remedy=remedy),)
    if may_hold:
        text = f"{what}, and may still hold something, which to {verb} would drop"
        remedy = f"Take that out; then use the service {service}."
        return (TransitionFailed(text, where=where, remedy=remedy),)
    return ()
