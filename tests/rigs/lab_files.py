"""Lab files of which several tests need the same."""

PAIR = """
name = "pair"
machine = "control"

[devices.arm]
plugin = "loopback"

[devices.camera]
plugin = "of-tracking"
machine = "tracking"
"""
"""Of two machines. The plugin of the second one is not installed on the first."""
