"""What makes a gripper ready may drop what it holds: when that is done, and when not."""

from __future__ import annotations

from crtk_drivers.errors import TransitionFailed

__all__ = ["may_be_dropped"]


def may_be_dropped(
    what: str, policy: str, service: str, *, may_hold: bool, where: str, verb: str
) -> None:
    """Refuse to make it ready where that is not wanted, or would drop something.

    Args:
        what: why it is not ready.
        policy: ``never``, or another.
        service: by which it is made ready by name.
        may_hold: it may hold something.
        where: for messages.
        verb: what it would be to make it ready: ``activate it``.

    Raises:
        TransitionFailed: with what to do.
    """
    if policy == "never":
        raise TransitionFailed(
            what, where=where, remedy=f"Have it done at its pendant or page, or use {service}."
        )
    if may_hold:
        raise TransitionFailed(
            f"{what}, and may still hold something, which to {verb} would drop",
            where=where,
            remedy=f"Take that out; then use the service {service}.",
        )
