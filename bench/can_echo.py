"""The other side of `bench.can_hub`: a python-can bus that sends every frame back, until told to end."""

from __future__ import annotations

import json
import sys

import can

END = 0x7FF
"""Identifier of the frame that ends it."""


def main() -> None:
    """Echo with the bus of the options in ``sys.argv[1]``."""
    with can.Bus(**json.loads(sys.argv[1])) as bus:
        while (message := bus.recv(30.0)) is not None and message.arbitration_id != END:
            bus.send(message, timeout=1.0)


if __name__ == "__main__":
    main()
