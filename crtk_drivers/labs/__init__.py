"""A lab: several devices and the programs that work beside them, written down once in a file."""

from crtk_drivers.labs.invocation import device_command, settings_text
from crtk_drivers.labs.lab_file import Lab, LabDevice, LabProgram, load_lab

__all__ = ["Lab", "LabDevice", "LabProgram", "device_command", "load_lab", "settings_text"]
