"""The work of ``slamsim live`` and ``slamsim replay``."""
