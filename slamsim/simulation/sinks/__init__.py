"""Kinds of sinks: each module here defines the ``SinkEntry`` of its kind and its sink.

The configuration imports them for their settings alone: what is heavy is imported when it is built.
"""
