"""NDI trackers: Polaris Vicra, Spectra, Vega and Lyra, and Aurora, by the Combined API."""

from crtk_driver_ndi.plugin import PLUGIN

__all__ = ["PLUGIN"]
