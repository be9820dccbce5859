"""The folder that a command writes into: a lock while it is under way, and a manifest of the files that it has written.

No command deletes or overwrites a file that it did not write. What it wrote is known from `manifest.json` in the
folder, never from the name of a file: the manifest lists a file before it is written, so that a kill between the two
leaves an entry without a file, never a file without an entry. All writers call `name` (`files.replacing` and
`files.History`), which does nothing outside of a folder that is held.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import stat
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from .. import __version__

MANIFEST, LOCK = "manifest.json", "isph.lock"
TEMPORARY = ".isph-"  # how the names of unfinished files begin
LOCKED_BYTE = 1 << 30  # Windows: beyond the end of the file, so that other processes can read its content, the holder


class FolderError(ValueError):
    """A folder that a command may not write into: the reason, and what to do."""


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; move it there if the block succeeds, remove it if not.

    The bytes are on the disk before the name is: not even a power cut leaves half a file under it.
    """
    handle, name = tempfile.mkstemp(prefix=f"{TEMPORARY}{path.stem}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    try:
        yield Path(name)
        os.chmod(name, 0o666 & ~_umask())
        with open(name, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(name, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(name)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


class Folder:
    """A folder held by one command: `with Folder(path, ...): ...`

    names: patterns of the files that will be written, relative to the folder: those of others are found before
    anything is computed. case: the case file that the results are of. keep: go on with the files that the manifest
    names and renew them; without it a folder in which the manifest names results is refused, or, with overwrite,
    emptied of them by `prepare`.

    Entering raises FolderError where another command holds the folder, where it has results, where a file of others
    would be overwritten, or where the manifest is none; nothing was changed then. Leaving removes the lock, and the
    folders that were made for nothing.
    """

    def __init__(self, path: str | os.PathLike, names: Sequence[str] = (), case: str | None = None,
                 keep: bool = False, overwrite: bool = False):  # fmt: skip
        self.path = Path(path).resolve()
        self.shown, self.names, self.case = str(path), names, case
        self.keep, self.overwrite = keep, overwrite
        # relative to the folder, in the order in which they were first written
        self.files: dict[str, None] = {}
        self.folders: dict[str, None] = {}  # that runs within this command fill; each has a manifest of its own
        self._named: list[str] = []  # entries of the manifest that was found, also of files that are gone
        self._prepared = False
        self._made: list[Path] = []
        self._handle: int | None = None

    def __enter__(self) -> Folder:
        if self.path.exists() and not self.path.is_dir():
            raise FolderError(f"{self.shown}: is a file; choose another folder with --out")
        try:
            self._take_lock()
            self._check()
        except BaseException:
            self._leave()
            raise
        _held[self.path] = self
        return self

    def __exit__(self, *exception: object) -> None:
        _held.pop(self.path, None)
        self._leave()

    def _make(self) -> None:
        missing = [p for p in (self.path, *self.path.parents) if not p.exists()]
        for path in reversed(missing):
            path.mkdir(exist_ok=True)
            self._made.append(path)

    def _leave(self) -> None:
        if self._handle is not None:
            _release(self._handle, self.path / LOCK)
            self._handle = None
        for path in reversed(self._made):
            with contextlib.suppress(OSError):  # it is not empty
                path.rmdir()
        self._made = []

    def _take_lock(self) -> None:
        """Takes a lock of the system on an open file, which ends with the process, however that ends. The content of
        the file only tells who holds it."""
        path = self.path / LOCK
        while self._handle is None:
            self._make()
            if os.path.lexists(path) and _holder(path) is None:
                raise FolderError(f"{self.shown}/{LOCK}: is no lock of isph; choose another folder with --out")
            try:
                handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            except FileNotFoundError:  # one that made the folder and was refused has removed it again
                continue
            try:
                if not _lock(handle):
                    who = _holder(path) or {}
                    where = f" (process {who['pid']} on {who['host']})" if {"pid", "host"} <= who.keys() else ""
                    raise FolderError(f"{self.shown}: another run is under way there{where}; wait for its end, or "
                                      "choose another folder with --out")
                with contextlib.suppress(FileNotFoundError):
                    if os.path.samestat(os.fstat(handle), os.stat(path)):  # else its holder has just removed it
                        self._handle = handle
            finally:
                if self._handle is None:
                    os.close(handle)
        who = {"pid": os.getpid(), "host": socket.gethostname()}
        os.ftruncate(self._handle, 0)
        os.write(self._handle, json.dumps(who).encode())

    def _check(self) -> None:
        found = self._read()
        self._named = list(found.get("files", ()))
        there = [name for name in self._named if os.path.lexists(self.path / name)]
        self.files = dict.fromkeys(there)  # a file that someone puts in the place of one that is gone is not ours
        self.folders = dict.fromkeys(found.get("folders", ()))
        if there and not (self.keep or self.overwrite):
            of = found.get("case")
            which = f"results of {of}" if of else "results"
            which += f", not of {self.case}" if of and self.case and of != self.case else ""
            goes_on = any(name.startswith("restart.") for name in there)
            how = f": go on with --restart {self.shown}," if goes_on else " and nothing for --restart to go on from:"
            raise FolderError(f"{self.shown}: holds {which}{how} replace them with --overwrite, or choose another "
                              "folder with --out")
        for pattern in self.names:
            for path in sorted(self.path.glob(pattern)):
                if self._relative(path) not in self.files:
                    raise self._foreign(path)
        if self.keep:
            self.case = found.get("case", self.case)

    def _read(self) -> dict[str, Any]:
        path = self.path / MANIFEST
        if not os.path.lexists(path):
            return {}
        wrong = FolderError(f"{self.shown}/{MANIFEST}: is no manifest of isph; choose another folder with --out")
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            names = [*found["files"], *found["folders"]]
            if found["program"] != "isphcli" or not all(isinstance(name, str) and name for name in names):
                raise wrong
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            raise wrong from None
        for name in names:  # nothing outside of the folder is ours, whatever a manifest says
            parts = PurePosixPath(name).parts
            plain = not PurePosixPath(name).is_absolute() and ".." not in parts and "\0" not in name
            if not plain or not (self.path / name).parent.resolve().is_relative_to(self.path):
                raise FolderError(f"{self.shown}/{MANIFEST}: names {name}, which is not in the folder; choose another "
                                  "folder with --out")
        return found

    def _relative(self, path: Path) -> str:
        return path.relative_to(self.path).as_posix()

    def _is_case(self, path: Path) -> bool:
        return self.case is not None and os.path.exists(self.case) and path.exists() and path.samefile(self.case)

    def _foreign(self, path: Path) -> FolderError:
        if self._is_case(path):
            return FolderError(f"{path}: is the case itself, and would be overwritten by the copy that a run leaves; "
                               "choose another folder with --out")
        return FolderError(f"{path}: is there already, and {MANIFEST} does not say that isph wrote it; move it, or "
                           "choose another folder with --out")

    def prepare(self) -> None:
        """Remove the files that the manifest names, unless they are kept, and unfinished files of a run that was
        killed.

        Where the case that runs is the copy of the case in this folder, that file stays until it is replaced: a kill
        must not lose it.
        """
        if self._prepared:
            return
        self._prepared = True
        for place in {self.path, *((self.path / name).parent for name in self._named)}:
            for file in place.glob(f"{TEMPORARY}*"):
                if self._relative(_finished(file)) in (*self._named, MANIFEST):
                    file.unlink()
        if not self.keep:
            stays = [name for name in self.files if self._is_case(self.path / name)]
            for name in self.files:
                path = self.path / name
                if name not in stays and (path.is_symlink() or path.is_file()):
                    path.unlink()
            self.files, self.folders = dict.fromkeys(stays), {}
            if self._named:
                self._write()

    def name(self, path: Path) -> None:
        """Name a file that is to be written. Raises FolderError where it is there and not ours."""
        name = self._relative(path)
        if name == MANIFEST or name in self.files:
            return
        if os.path.lexists(path):
            raise self._foreign(path)
        self.files[name] = None
        self._write()

    def owns(self, path: Path) -> bool:
        """Whether the results in a subfolder belong to this command; a subfolder without results becomes its own."""
        name = self._relative(path)
        if name in self.folders:
            return True
        if not os.path.lexists(path / MANIFEST):
            self.folders[name] = None
            self._write()
        return False

    def _write(self) -> None:
        text = {"program": "isphcli", "version": __version__, "case": self.case, "files": list(self.files),
                "folders": list(self.folders)}  # fmt: skip
        with whole(self.path / MANIFEST) as temporary:
            temporary.write_text(json.dumps(text, indent=1) + "\n", encoding="utf-8")


_held: dict[Path, Folder] = {}


def _around(path: str | os.PathLike) -> tuple[Folder | None, Path]:
    """(the innermost folder that is held and in which the path lies, the path without links in its folder)."""
    path = Path(path)
    path = path.parent.resolve() / path.name
    return next((_held[parent] for parent in path.parents if parent in _held), None), path


def name(path: str | os.PathLike) -> None:
    """Name a file before it is written. Raises FolderError where it lies in a folder that is held, and is not ours."""
    folder, path = _around(path)
    if folder is not None:
        folder.name(path)


def remove(path: str | os.PathLike) -> None:
    """Remove a file that the manifest of the folder that is held names; any other stays."""
    folder, path = _around(path)
    if folder is not None and path.relative_to(folder.path).as_posix() in folder.files:
        path.unlink(missing_ok=True)


def ours(path: str | os.PathLike) -> bool:
    """Whether the command that holds a folder around `path` has filled `path` before, and may replace what is there."""
    folder, path = _around(path)
    return folder is not None and folder.path != path and folder.owns(path)


def prepare(path: str | os.PathLike) -> Path:
    """The folder, made, and if it is held prepared for new files; see `Folder.prepare`."""
    path = Path(path)
    path.mkdir(parents=True, exist_ok=True)
    folder = _held.get(path.resolve())
    if folder is not None:
        folder.prepare()
    return path


def _finished(temporary: Path) -> Path:
    """The path that an unfinished file was to have."""
    stem, _, _ = temporary.name[len(TEMPORARY) : len(temporary.name) - len(temporary.suffix)].rpartition(".")
    return temporary.with_name(stem + temporary.suffix)


# -- the lock --------------------------------------------------------------------------------------------


def _holder(path: Path) -> dict[str, Any] | None:
    """The holder that a lock names; {} where it names none yet; None for a file that is no lock."""
    try:
        if not stat.S_ISREG(os.lstat(path).st_mode):
            return None
        found = json.loads(path.read_bytes()[:1000] or b"{}")
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and found.keys() <= {"pid", "host"} else None


def _lock(handle: int) -> bool:
    """Lock an open file; False where another process holds it. On a file system without locks nothing is locked or
    refused."""
    try:
        import fcntl
    except ImportError:
        import msvcrt

        os.lseek(handle, LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError:
            return False
        os.lseek(handle, 0, os.SEEK_SET)
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _release(handle: int, path: Path) -> None:
    """Remove the file of a lock that is held, then release it: a process that has opened the file meanwhile finds that
    it is gone, and opens a new one."""
    with contextlib.suppress(OSError):
        os.unlink(path)
    os.close(handle)
    with contextlib.suppress(OSError):  # Windows removes no file that is open
        if os.name == "nt":
            os.unlink(path)
