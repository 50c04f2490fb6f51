"""``slamsim bench cameras``: speed and exactness of cameras, and what perception makes of them."""
