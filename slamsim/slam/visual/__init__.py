"""SLAM without a lidar: the path of a camera from depth, tags and wheels, in one pose graph."""
