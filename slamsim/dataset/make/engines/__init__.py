"""Engines that make sequences: the cores of this machine, or a cluster."""
