"""Encoded images: JPEG and PNG, lossless depth (PNG, RVL, zstd), and compressedDepth of ROS."""
