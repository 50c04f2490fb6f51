"""SLAM under random conditions: rates of tracked, reported failure, and silently wrong."""
