"""Models that several stages share: differential drive and gyroscope, and sparse block systems.

Simulation, odometry, SLAM, checker, repairs and scenarios take the motion of a wheeled robot from
here alone. Nothing in it knows a recording, a configuration or a file.
"""
