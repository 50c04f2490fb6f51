"""Name of the recording inside the folder of a run or sequence (rosbag2 or Parquet)."""

LOG, TABLES = "log", "parquet"
