"""Benchmarks of speed and accuracy over many runs, one module per part."""
