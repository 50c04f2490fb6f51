"""Kinds of sensors: each module here defines the ``SensorEntry`` of its kind and its sensor.

The configuration imports them for their settings alone: what is heavy is imported when it is built.
"""
