"""A simulated ATI NetFT sensor box."""
