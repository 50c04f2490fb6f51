"""Cameras at a site: rays, frames, images, and their truth."""
