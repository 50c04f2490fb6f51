"""Who makes the sequences: the cores of this machine, or a cluster."""
