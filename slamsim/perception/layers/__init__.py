"""Layers of a map from images: obstacles, labels."""
