"""Servers of a live robot: each module has one ``start_...`` that gives a ``Server``."""
