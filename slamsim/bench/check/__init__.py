"""How well the checker finds, names and measures what is wrong: known faults in random drives."""
