"""What stops the robot, and its way up and down between power off and running."""
