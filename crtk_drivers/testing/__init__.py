"""For authors of drivers and tests: a device without hardware, and what else helps to test one."""
