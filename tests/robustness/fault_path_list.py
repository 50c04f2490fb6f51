"""Every attempt to reach outside a folder: importing this puts them on the list."""

import fault_path_commands
import fault_path_configs
import fault_path_datasets
import fault_path_outputs
import fault_path_recordings
import fault_path_runs
import fault_path_worlds
from fault_paths import ATTEMPTS

__all__ = [
    "ATTEMPTS",
    "fault_path_commands",
    "fault_path_configs",
    "fault_path_datasets",
    "fault_path_outputs",
    "fault_path_recordings",
    "fault_path_runs",
    "fault_path_worlds",
]
