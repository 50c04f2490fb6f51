"""What is asked of cameras."""
