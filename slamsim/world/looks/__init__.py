"""How a world looks: materials, what hangs on walls, lamps; evaluated where a ray hits."""
