"""Commands that show and write camera images."""
