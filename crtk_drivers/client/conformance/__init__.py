"""Whether a device speaks CRTK as it is written: clauses, what was seen of a device, and judges of that.

Nothing here imports ROS: `crtk_drivers.client.conformance.probe` looks and asks, and the judges are
functions of what it brings, so that they are tested on observations that were made up.
"""
