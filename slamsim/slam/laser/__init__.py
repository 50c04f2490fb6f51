"""The laser by its scans alone: motion, shape of the scans, mount."""
