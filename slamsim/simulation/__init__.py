"""From a drive to its recording: what is sensed, with or without faults, and what is left of it."""
