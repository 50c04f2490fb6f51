"""Cameras: lenses, shutters, sensors, and the rendering of frames with their truth."""
