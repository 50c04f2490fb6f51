"""A labyrinth simulator, a 2-D SLAM system and a checker of recordings."""

__version__ = "0.1.0"
