"""The two gates: what may be commanded, and what may reach the hardware."""
