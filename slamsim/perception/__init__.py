"""What images tell: tags, the camera's own motion, and where both put the robot."""
