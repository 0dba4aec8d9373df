"""A device that runs, with all that it needs; and what a page for the browser shows of it."""

from crtk_drivers.session.opened import Session, engine_options, open_session, reached, start_sim_of

__all__ = [
    "Session",
    "engine_options",
    "open_session",
    "reached",
    "start_sim_of",
]
