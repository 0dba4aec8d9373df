"""Recordings: MCAP files of ROS 2 messages, written and read without ROS."""

from crtk_drivers.recording.mcap_reader import Attachment, Message, Recording, mend
from crtk_drivers.recording.mcap_writer import McapWriter
from crtk_drivers.recording.opening import opened
from crtk_drivers.recording.recorder import Recorder, Totals
from crtk_drivers.recording.series import Raw, Series, Split

__all__ = [
    "Attachment",
    "McapWriter",
    "Message",
    "Raw",
    "Recorder",
    "Recording",
    "Series",
    "Split",
    "Totals",
    "mend",
    "opened",
]
