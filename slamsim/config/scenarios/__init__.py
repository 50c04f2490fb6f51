"""One module per scenario: its parameters, with the values of the study as defaults."""
