"""What each command does, from its input to its complete output folder."""
