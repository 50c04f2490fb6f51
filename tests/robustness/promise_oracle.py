"""What a command may leave of a tree of user files: told without any code of slamsim.

Whatever is not at, in or a remain of an output that the command announced is as it was, byte for
byte. An output that was there is replaced only if its ``SHA256SUMS`` lists every file of it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from promise_arguments import Command
from promise_endings import Ended, Ending

CODES = frozenset((0, 1, 2, 3, 4, 10, 11, 75))
_FINISHED = frozenset((0, 1))
_STOPPED: Mapping[str, frozenset[int]] = {
    "SIGTERM": frozenset((143, -15)),
    "SIGKILL": frozenset((-9,)),
    "SIGKILL at a change": frozenset((-9,)),
}
_GRACE_S = 1.4
_SUM = re.compile(r"([0-9a-f]{64})  ([^\n]+)")
_HIDDEN = r"slamsim-(?:lock|[0-9a-f]{16})"

Entry = tuple[str, int, str, int]
"""Kind, mode, target or SHA-256, time of change in ns (of files)."""
Snapshot = Mapping[str, Entry]


def snapshot(root: Path) -> dict[str, Entry]:
    """Everything below a folder, by its path; no link is followed."""
    found = {}
    for folder, folders, names in os.walk(root):
        for name in (*folders, *names):
            path = Path(folder, name)
            state = path.lstat()
            kind, told, changed_ns = "other", "", 0
            if stat.S_ISDIR(state.st_mode):
                kind = "folder"
            elif stat.S_ISLNK(state.st_mode):
                kind, told = "link", os.readlink(path)  # noqa: PTH115
            elif stat.S_ISREG(state.st_mode):
                kind, changed_ns = "file", state.st_mtime_ns
                told = hashlib.sha256(path.read_bytes()).hexdigest()
            found[str(path)] = (kind, stat.S_IMODE(state.st_mode), told, changed_ns)
    return found


def listed(folder: str, there: Snapshot) -> dict[str, str] | None:
    """The files that the ``SHA256SUMS`` of a folder lists, by path; nothing if it has none.

    Read when the snapshot is taken, for the folder may be replaced.
    """
    sums = f"{folder}/SHA256SUMS"
    if there.get(sums, ("",))[0] != "file":
        return None
    lines = Path(sums).read_text(encoding="utf-8", errors="replace").split("\n")
    found = {f"{folder}/{line[2]}": line[1] for line in map(_SUM.fullmatch, lines) if line}
    return {**found, sums: there[sums][2]}


@dataclass(frozen=True)
class Before:
    """The tree before a command. lists: the ``SHA256SUMS`` of every folder that has one."""

    there: Snapshot
    lists: Mapping[str, Mapping[str, str]]

    @classmethod
    def of(cls, root: Path) -> Before:
        there = snapshot(root)
        lists = {folder: listed(folder, there) for folder in _folders(there)}
        return cls(there, {folder: sums for folder, sums in lists.items() if sums is not None})

    def is_replaceable(self, folder: str) -> bool:
        """Whether slamsim sealed it, and its seal lists every file and link in it."""
        sums = self.lists.get(folder)
        inside = _below(folder, self.there)
        return sums is not None and f"{folder}/.slamsim" in inside and inside <= sums.keys()

    def is_sealed(self, file: str) -> bool:
        return any(file in sums for sums in self.lists.values())


def _folders(there: Snapshot) -> Iterator[str]:
    return (path for path, entry in there.items() if entry[0] == "folder")


def _below(folder: str, there: Snapshot) -> set[str]:
    """The files, links and pipes in a folder."""
    return {
        path
        for path, entry in there.items()
        if path.startswith(f"{folder}/") and entry[0] != "folder"
    }


class Judge:
    """One command in one tree."""

    def __init__(self, root: Path, command: Command, before: Before, remains: set[str]) -> None:
        """remains: what an earlier, killed run of the same command left hidden, which may go."""
        self._root, self._work = str(root), str(root / "work")
        self._command, self._before = command, before
        self._remains = remains
        self._outputs = os.path.realpath(f"{self._work}/outputs")
        self.folder = None if command.folder is None else self._real(command.folder)
        self._files = [self._real(name, follow=False) for name in command.files]

    def _real(self, typed: str, *, follow: bool | None = None) -> str:
        """Where it is written: links above it are followed, and at its end only by data sets."""
        whole = os.path.join(self._work, typed).rstrip("/") or "/"  # noqa: PTH118
        follow = self._command.in_parts if follow is None else follow
        above, name = os.path.split(os.path.normpath(whole) if whole.endswith("/.") else whole)
        if follow or name in ("", ".", ".."):
            return os.path.realpath(whole)
        return f"{os.path.realpath(above)}/{name}"

    def broken(self, ended: Ended, ending: Ending, after: Snapshot) -> Iterator[str]:
        """Each promise that was not kept."""
        yield from self._ended_wrong(ended, ending)
        struck = ending.is_kill or ending.kind in ("file size", "full at a change")
        struck = struck or ended.code == -15 or ended.after_signal_s > _GRACE_S
        for path in sorted(self._before.there.keys() | after.keys()):
            old, new = self._before.there.get(path), after.get(path)
            if old == new or self._is_remain(path):
                continue
            if old is None:
                if not (self._may_be_new(path, ended, after) or (struck and self._is_hidden(path))):
                    yield f"new: {path}"
                continue
            is_touched = new is None or old[0] == "file" or old[:3] != new[:3]
            if is_touched and not self._may_change(path, after):
                yield f"{'changed' if new else 'gone'}: {path}"
        yield from self._left_wrong(ended, after)

    def _ended_wrong(self, ended: Ended, ending: Ending) -> Iterator[str]:
        if ended.code not in CODES | _STOPPED.get(ending.kind, frozenset()):
            yield f"exit code {ended.code}: {ended.told[-600:]}"
        if "Traceback (most recent call last)" in ended.told:
            yield f"traceback: {ended.told[-1200:]}"
        if ended.hung:
            yield "it hangs"
        if ended.left:
            yield "a process of it stays"

    def _left_wrong(self, ended: Ended, after: Snapshot) -> Iterator[str]:
        """What stands under the announced names is whole, and finished work is there."""
        for folder in self.results(after):
            if self._command.in_parts or after == self._before.there:
                continue
            sums = listed(folder, after)
            if sums is None or _below(folder, after) != sums.keys():
                yield f"not sealed whole: {folder}"
            elif any(after[path][2] != told for path, told in sums.items()):
                yield f"not as its seal says: {folder}"
            if ended.code in CODES - _FINISHED:
                yield f"it ended with {ended.code} and left {folder}"
        if ended.code == 0 and "--list" not in self._command.arguments:
            for path in (self.folder, *(self._files if len(self._files) == 1 else ())):
                if path is not None and path not in after:
                    yield f"it ended with 0, and there is no {path}"

    def results(self, after: Snapshot) -> list[str]:
        """Announced folders that this command made or replaced."""
        announced = [self.folder] if self.folder is not None else []
        if self._command.under_outputs:
            announced = [path for path in _folders(after) if self._is_default(path)]
        mark = "SHA256SUMS"
        return [
            path
            for path in announced
            if path in after
            and (path not in self._before.there or self._is_other(f"{path}/{mark}", after))
        ]

    def _is_other(self, path: str, after: Snapshot) -> bool:
        return self._before.there.get(path) != after.get(path)

    def _is_default(self, path: str) -> bool:
        above, name = os.path.split(path)
        return self._command.under_outputs and above == self._outputs and name[0] != "."

    def _may_be_new(self, path: str, ended: Ended, after: Snapshot) -> bool:
        for folder in self.results(after):
            if path == folder or path.startswith(f"{folder}/"):
                return True
            if folder.startswith(f"{path}/"):  # one of the folders above it
                return True
        if self._command.in_parts and self.folder is not None:
            return f"{path}/".startswith(f"{self.folder}/") or self.folder.startswith(f"{path}/")
        made = [file for file in self._files if file in after]
        if self._command.under_outputs and path == self._outputs:
            return any(self._is_default(folder) for folder in _folders(after))
        return path in made or any(file.startswith(f"{path}/") for file in made)

    def _may_change(self, path: str, after: Snapshot) -> bool:
        """Whether this was slamsim's own, and it was told to replace it."""
        if self._command.in_parts and self.folder is not None:
            own = self._before.lists.get(self.folder, {})
            logs = path.startswith(f"{self.folder}/logs/")
            return path in own or logs or self._was_empty(path, self.folder)
        if self.folder is not None and self._was_empty(path, self.folder):
            return True
        if not self._command.overwrite:
            return False
        if path in self._files:
            there = self._before.there[path]
            return there[0] == "file" and path in after and not self._before.is_sealed(path)
        for folder in (path, *map(str, Path(path).parents)):
            if folder == self.folder or self._is_default(folder):
                return self._before.is_replaceable(folder) and folder in after
        return False

    def _was_empty(self, path: str, folder: str) -> bool:
        """An empty folder under the announced name is anybody's: its mode may be another."""
        inside = any(name.startswith(f"{folder}/") for name in self._before.there)
        return path == folder and not inside

    def _is_hidden(self, path: str) -> bool:
        """Whether this belongs to the protocol of locks and staging folders, of an announced name.

        Folders above the output that were made for it may be left, too.
        """
        if path in self.hidden(self._before.there.keys() | {path}):
            return True
        announced = [*self._files, *((self.folder,) if self.folder is not None else ())]
        if self._command.under_outputs:
            announced.append(f"{self._outputs}/any")
        return any(name.startswith(f"{path}/") for name in announced)

    def hidden(self, paths: set[str]) -> set[str]:
        """Those of the paths that were not there before and belong to this protocol."""
        names = [*self._files, *((self.folder,) if self.folder is not None else ())]
        beside = [
            f"{re.escape(os.path.dirname(name))}/\\.{re.escape(os.path.basename(name))}\\.{_HIDDEN}"  # noqa: PTH119, PTH120
            for name in names
        ]
        if self._command.under_outputs:
            beside.append(f"{re.escape(self._outputs)}/\\.[^/]+\\.{_HIDDEN}")
        if self._command.in_parts and self.folder is not None:
            beside.append(f"{re.escape(self.folder)}/\\.{_HIDDEN}")
        if not beside:
            return set()
        known = re.compile(f"(?:{'|'.join(beside)})(?:/.*)?", re.DOTALL)
        return {path for path in paths - self._before.there.keys() if known.fullmatch(path)}

    def _is_remain(self, path: str) -> bool:
        return any(path == one or path.startswith(f"{one}/") for one in self._remains)


def unmarked(hidden: set[str]) -> Iterator[str]:
    """Remains that do not say that they are slamsim's.

    A staging folder, and the marker in it, may be empty as yet: its lock file names it.
    """
    for path in sorted(path for path in hidden if str(Path(path).parent) not in hidden):
        if path.endswith(".slamsim-lock"):
            marker = Path(path)
        elif re.search(r"slamsim-[0-9a-f]{16}$", path) and any(Path(path).iterdir()):
            marker = Path(path) / "slamsim-staging.json"
        else:
            continue
        try:
            text = marker.read_text()
            is_ours = "slamsim" in json.loads(text) if text else marker.parent == Path(path)
        except (OSError, ValueError):
            is_ours = False
        if not is_ours:
            yield f"a remain without a marker: {path}"
