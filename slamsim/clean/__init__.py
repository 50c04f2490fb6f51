"""From what a recording says to what SLAM can use: no-return values, range limits, stamps."""
