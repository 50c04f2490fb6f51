"""Reads, writes, copies and salvages recordings of every format."""

LOG, TABLES = "log", "parquet"
"""Name of the recording inside the folder of a run or sequence: rosbag2 or Parquet."""
