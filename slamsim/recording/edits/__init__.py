"""Edits of recordings: small typed values that turn one recording into another.

Faults (``slamsim.sensors.faults``) and repairs (``slamsim.recording.repairs``) are declarations
over this one library: a fault chooses an edit and its size, a repair takes size and subject from a
finding. An edit that loses nothing has an inverse.
"""
