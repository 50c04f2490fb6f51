"""How fast, and how good: measurements over many runs, one module per part."""
