"""Programs: how they are run, and the built-ins that they call."""
