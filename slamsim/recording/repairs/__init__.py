"""Repairs of recordings: what ``slamsim fix`` can apply, each an edit with the size of a finding.

A finding names a repair, its subject and its numbers (``Repair``); nothing here knows how they
were found.
"""
