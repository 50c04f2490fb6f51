"""Tags in the pose graph: as landmarks of unknown or of surveyed places."""
