"""Detection rates of the checker: known faults in random drives."""
