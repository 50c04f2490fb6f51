"""A second generator of recordings, which shares no code with slamsim.

Own rays, rooms, drives, sensors and faults on numpy alone; files are written by rosbags. Constants
of the checker are fitted on slamsim's own simulator and scored here: ``slamsim bench check
--independent``, which calls ``cases`` and ``make``.
"""

from independent.cases import Case, Expected, cases, fault_names, make

__all__ = ["Case", "Expected", "cases", "fault_names", "make"]
