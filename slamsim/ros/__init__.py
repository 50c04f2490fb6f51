"""A ROS 2 node that maps a robot: ``python -m slamsim.ros``. Alone imports rclpy."""
