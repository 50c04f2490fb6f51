"""From a drive to its recording: sensing, faults, streams and files."""
