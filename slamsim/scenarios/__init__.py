"""What a simulator of robots is judged by: physics and driving against theory and reality."""
