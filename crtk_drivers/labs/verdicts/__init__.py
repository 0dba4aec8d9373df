"""Measurements, bounds and verdicts, and how they are told: terminal, JSON, JUnit, HTML. Pure."""
