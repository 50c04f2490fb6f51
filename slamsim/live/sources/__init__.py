"""Robots that run elsewhere, as sources of messages: ``connect.open_source``."""
