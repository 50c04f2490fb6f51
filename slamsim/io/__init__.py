"""Reads, writes, copies and salvages recordings of every format."""
