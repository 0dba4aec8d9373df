"""The hardware-in-the-loop bench: tests that move a device, recordings of them, and verdicts."""
