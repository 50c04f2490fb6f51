"""Benchmarks of speed and accuracy over many runs, one module per part."""

Figures = dict[str, object]
"""What a part measured, by the names that ``--json`` tells."""
