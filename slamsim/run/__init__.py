"""What each command does, from its input to a folder that is whole."""
