"""ATI NetFT force/torque sensors: Net Box, Ethernet Axia, SCHUNK FTN and OnRobot HEX."""
