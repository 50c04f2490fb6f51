"""Parameters of the scenarios, with the values of the study as defaults."""
