"""CRTK driver for Universal Robots arms (CB3 and e-Series)."""
