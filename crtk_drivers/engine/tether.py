"""Free drive and gravity compensation last as long as the client that asked for them, if the user wants that.

A tether is tied when one of them is asked for, by the client that asks. It is broken when that client has
gone, or has not asked again in time.
"""

from __future__ import annotations

from crtk_drivers.motion.arbiter import Client
from crtk_drivers.status.deadman import Deadman


class Tether:
    """Tells when what one client asked for is to end. `tie` and `cut` from any thread, `broken` from one.

    Args:
        to_client: whether it breaks when the client has gone.
        timeout: seconds after which it breaks unless it is tied again; None: never.
    """

    def __init__(self, to_client: bool, timeout: float | None) -> None:
        self._to_client = to_client
        self._silence = None if timeout is None else Deadman(timeout)
        self._client: Client | None = None

    def tie(self, client: Client, now: float) -> None:
        """A client asks for it, or asks again, at monotonic seconds."""
        if self._silence is not None:
            self._silence.feed(now)
        self._client = client

    def cut(self) -> None:
        """It has ended: there is no client to look after."""
        self._client = None

    def broken(self, now: float) -> str:
        """Return why it is to end, once; empty if it may go on."""
        client = self._client
        if client is None:
            return ""
        reason = ""
        if self._to_client and not client.is_there:
            reason = f"{client.name} has gone"
        elif self._silence is not None and self._silence.expired(now):
            reason = f"it was not asked for again in {self._silence.timeout:g} s"
        if reason:
            self.cut()
        return reason
