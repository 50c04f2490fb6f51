"""Copies of recordings in which nothing is lost that was not meant to change."""
