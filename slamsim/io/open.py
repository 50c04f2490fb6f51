"""Opens recordings of every format, as written and as SLAM reads them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from slamsim.core.types import Log, Trajectory
from slamsim.guard.errors import InputRefused, NotFound, OverrideRefused
from slamsim.guard.files import own_file
from slamsim.guard.unpacking import PACKED_TWICE, PACKINGS
from slamsim.io import LOG, TABLES
from slamsim.io.formats import Contents, Format, Survey, Truth, formats
from slamsim.io.input_errors import as_input_errors
from slamsim.io.ros.parts import several_recordings
from slamsim.io.selection import EVERYTHING, Selection, selected
from slamsim.recording import Recording
from slamsim.recording.choice import clouds_to_read, not_of_ros
from slamsim.recording.cleaning.log import clean
from slamsim.recording.cleaning.streams import trajectory_of
from slamsim.recording.clouds import CloudsWanted


@dataclass(frozen=True, slots=True, eq=False)
class OpenRecording:
    """A recording that was read once: what it says, the log in it, the truth in it."""

    path: Path
    contents: Contents

    @property
    def recording(self) -> Recording:
        return self.contents.recording

    def log(self) -> Log:
        """As SLAM reads it. Raises InputRefused as ``read_log`` does."""
        with as_input_errors(self.path, "its contents"):
            return clean(self.recording, self.path)

    def truth(self) -> Trajectory | None:
        """As ``read_truth`` gives it. Raises InputRefused for one that is damaged."""
        if self.contents.truth_damage is not None:
            where, reason = self.contents.truth_damage
            raise InputRefused(self.path, reason, where)
        if self.contents.truth is None:
            return None
        with as_input_errors(self.path, "its truth"):
            truth = trajectory_of(self.contents.truth)
        return truth if len(truth) else None


def open_recording(path: Path, wanted: Selection = EVERYTHING) -> OpenRecording:
    """Read the recording at path, with the truth in it, which no log or recording shows.

    Of a format that is registered in ``slamsim.io.formats``, or a run's folder that holds one.
    wanted: of several topics of a kind only these. Memory stays bounded: from a certain size on
    ranges live in a temporary file. Raises NotFound, or InputRefused naming file, place and reason
    when it cannot be read at all, OverrideRefused for what is wanted and not there; what only some
    messages suffer from stands in ``Recording.anomalies`` and ``unread``.
    """
    path = recording_at(path)
    return OpenRecording(path, _read(path, "with", wanted))


def read_recording(
    path: Path, wanted: Selection = EVERYTHING, *, may_be_empty: bool = False
) -> Recording:
    """What the recording at path says; as ``open_recording`` without the truth.

    Raises InputRefused besides for a recording of which no topic can be read, unless it may be
    empty: of a recording with images alone.
    """
    path = recording_at(path)
    found = _read(path, "without", wanted).recording
    if not may_be_empty:
        require_something(path, found)
    return found


def holds_something(found: Recording) -> bool:
    """Whether there is anything in a recording that is read."""
    images = (*found.cameras, *found.unread_cameras)
    beside = (found.transforms, found.robot_description, found.clock_ns, images)
    return bool(found.streams) or not all(each is None or each == () for each in beside)


def require_something(path: Path, found: Recording) -> None:
    """Raises InputRefused for a recording in which nothing was found that is read."""
    if not holds_something(found):
        there = ", ".join(sorted({each.type_name for each in found.topics if each.messages}))
        damage = (f"; {each.topic}: {each.damage}" for each in found.topics if each.damage)
        why = next(damage, not_of_ros(found.topics))
        held = f"only {there}{why}" if there else "no message at all"
        raise InputRefused(path, f"there is nothing that could be checked, {held}")


def survey_recording(path: Path, wanted: Selection = EVERYTHING) -> Survey:
    """What is in the recording at path, quickly; raises as ``open_recording`` does."""
    path = recording_at(path)
    with as_input_errors(path, "its contents"):
        found = format_of(path).survey(path)
        sample = _sliced(path, found.sample, wanted, is_sampled=True)
        return replace(found, sample=selected(sample, wanted, path))


def read_log(path: Path, wanted: Selection = EVERYTHING) -> Log:
    """The log at path: what the recording says, sorted, converted, with warnings.

    The truth in it, if any, is never read. wanted chooses among several topics of a kind;
    ``Log.sources`` says which were read. Raises NotFound, InputRefused naming file, place and
    reason, or OverrideRefused for what is wanted and not there.
    """
    path = recording_at(path)
    return OpenRecording(path, _read(path, "without", wanted)).log()


def _read(path: Path, truth: Truth, wanted: Selection) -> Contents:
    """Of a path that ``recording_at`` gave."""
    with as_input_errors(path, "its contents"):
        contents = format_of(path).read(path, truth)
        recording = _sliced(path, contents.recording, wanted)
        return replace(contents, recording=selected(recording, wanted, path))


def _sliced(
    path: Path, recording: Recording, wanted: Selection, *, is_sampled: bool = False
) -> Recording:
    """With scans that are cut out of point clouds, where there are no others."""
    slice_clouds = format_of(path).sliced
    topics = clouds_to_read(recording, wanted.scans)
    if slice_clouds is None or not topics:
        if wanted.cloud_height_m is not None:
            reason = f"no scans of {path} are cut out of point clouds"
            raise OverrideRefused("--cloud-height", reason)
        return recording
    heights_m, base_frame = wanted.cloud_height_m, wanted.base_frame
    return slice_clouds(path, recording, CloudsWanted(topics, heights_m, base_frame, is_sampled))


def read_truth(path: Path) -> Trajectory | None:
    """``T_map_base`` as the simulator recorded it, or None for a log without truth."""
    path = recording_at(path)
    found = format_of(path)
    if not found.has_truth:
        return None
    with as_input_errors(path, "its truth"):
        return OpenRecording(path, found.read(path, "only")).truth()


def checked_recording(path: Path) -> str:
    """Read a recording to its last byte, and say in words what its checksums prove.

    Raises NotFound, or InputRefused where it is damaged or none.
    """
    path = recording_at(path)
    return format_of(path).checksums(path)


def format_of(path: Path) -> Format:
    """The format of a path that ``recording_at`` gave."""
    return next(each for each in formats() if each.is_at(path))


def recording_at(path: Path) -> Path:
    """The recording that a path means; InputRefused when it can be none."""
    if not path.exists():
        raise NotFound(f"{path}: there is no such file or folder")
    known = formats()
    if not path.is_dir():
        if any(each.is_file(path) for each in known):
            return path
        if len(path.suffixes) > 1 and set(path.suffixes[-2:]) <= set(PACKINGS):
            raise InputRefused(path, PACKED_TWICE)
        suffix = path.suffix or "a name without a suffix"
        raise InputRefused(path, f"{suffix} is not a known log format; {_about(known)}")
    for each in known:
        for name in (".", LOG, TABLES):
            found = each.in_folder(path / name)
            if found is not None:
                return own_file(path, found.relative_to(path).as_posix())
    files = sorted(file for file in path.iterdir() if any(each.is_file(file) for each in known))
    if len(files) == 1:
        return own_file(path, files[0].name)
    if files:
        raise several_recordings(path, files)
    raise InputRefused(path, f"there is no recording in this folder; {_about(known)}")


def _about(known: tuple[Format, ...]) -> str:
    files = ", ".join(each.about_files for each in known if each.about_files)
    folders = ", ".join(each.about_folders for each in known if each.about_folders)
    return f"a log is {files}, or a folder with one of these, or {folders}"
