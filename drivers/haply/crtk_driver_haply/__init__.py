"""Haply Inverse3 with VerseGrip, by Haply's Inverse service, as a CRTK device."""

from crtk_driver_haply.plugin import PLUGIN

__all__ = ["PLUGIN"]
