"""All faults by name."""

from __future__ import annotations

from independent.fault import Fault
from independent.faults_sized import SIZED

FAULTS: dict[str, Fault] = {each.name: each for each in SIZED}
