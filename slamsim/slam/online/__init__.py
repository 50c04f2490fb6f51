"""SLAM as a stream: motion as it arrives, and a back end that solves beside it."""
