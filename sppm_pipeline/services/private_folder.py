"""Folders that no other user can write to: what is loaded from one is code or a result that this user has made."""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import stat
import sys
import tempfile
from pathlib import Path


def make_private(path: Path) -> None:
    """Make a folder and missing ones above it, closed to other users."""
    for folder in reversed([folder for folder in (path, *path.parents) if not folder.is_dir()]):
        with contextlib.suppress(FileExistsError):  # another process has made it meanwhile
            os.mkdir(folder, 0o700)
    if not path.is_dir():
        raise NotADirectoryError(20, "Not a directory", str(path))


def exposure(path: Path) -> str:
    """Reason why another user may have written to a folder; empty if none can.

    The folder itself must belong to this user or root, be no link, and be closed to other writers; the one it lies in
    must be closed or sticky, as the temporary folder is, so that no other user can replace it. The folders above are
    the user's choice.
    """
    if sys.platform == "win32":  # folders of a user are closed by their access lists
        return ""
    try:
        about, above = path.lstat(), path.parent.stat()
    except OSError as error:
        return error.strerror or str(error)
    if stat.S_ISLNK(about.st_mode):
        return "it is a symbolic link"
    if not stat.S_ISDIR(about.st_mode):
        return "it is no folder"
    if reason := writers(about):
        return reason
    if _open_to_others(above) and not above.st_mode & stat.S_ISVTX:
        return f"other users may replace it (mode {stat.S_IMODE(above.st_mode):o} of {str(path.parent)!r})"
    return ""


def writers(about: os.stat_result) -> str:
    """Reason why another user may have written to what this is about; empty if none can."""
    if sys.platform == "win32":
        return ""
    if about.st_uid not in (os.geteuid(), 0):
        return f"it belongs to the user {about.st_uid}"
    if _open_to_others(about):
        return f"other users may write to it (mode {stat.S_IMODE(about.st_mode):o})"
    return ""


def _open_to_others(about: os.stat_result) -> bool:
    if about.st_mode & stat.S_IWOTH:
        return True
    return bool(about.st_mode & stat.S_IWGRP) and not _is_own_group(about.st_gid)


@functools.cache
def _is_own_group(group: int) -> bool:
    """Many systems give each user a group of the same name, and let new folders be writable by it."""
    import grp
    import pwd

    try:
        return grp.getgrgid(group).gr_name == pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return False


def temporary_folder(prefix: str) -> Path:
    """A new folder of this process, which goes when it ends."""
    from multiprocessing.util import Finalize  # which also runs where a child ends without exit handlers

    folder = tempfile.mkdtemp(prefix=prefix)
    Finalize(None, shutil.rmtree, (folder, True), exitpriority=0)
    return Path(folder)
