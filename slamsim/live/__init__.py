"""A robot that is simulated in real time, mapped while it drives, and served to clients."""
