"""Synthetic SLAM data sets by the thousand: recipe, sequences, engines, catalogue, reader."""
