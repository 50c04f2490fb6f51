"""What the recording in the folder of a run or of a sequence is called, rosbag2 or Parquet."""

LOG, TABLES = "log", "parquet"
