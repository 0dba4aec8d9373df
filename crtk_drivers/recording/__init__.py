"""Recordings: MCAP files of ROS 2 messages, written and read without ROS."""

from crtk_drivers.recording.mcap_reader import Attachment, Message, Recording, mend
from crtk_drivers.recording.mcap_writer import McapWriter
from crtk_drivers.recording.recorder import Recorder, Totals

__all__ = ["Attachment", "McapWriter", "Message", "Recorder", "Recording", "Totals", "mend"]
