"""Scenarios that validate a robot simulator against theory and measurements."""
