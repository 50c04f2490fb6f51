"""Robots that run elsewhere, as sources of messages: ``clients.open_source``."""
