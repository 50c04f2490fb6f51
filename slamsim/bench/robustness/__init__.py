"""SLAM under random conditions: how often it tracks, tells that it failed, or is silently wrong."""
