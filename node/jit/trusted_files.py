"""Checks whose files are there: only what nobody but us and root can have put into a place is loaded as code.

Compiled code is kept as pickles, and who lays a pickle where another loads it runs code as that other. So a directory
is believed only if it is ours or root's, nobody else may write in it, and none of the directories above it lets anybody
else put another in its place. As everywhere in Unix that holds of a directory where all may write if it is sticky.
"""

from __future__ import annotations

import grp
import os
import pwd
import stat
from functools import cache
from pathlib import Path


def why_not_trusted(path: str) -> str | None:
    """Say why the files in a directory, whose own name is no link, may be another user's; None if they cannot."""
    above = os.path.realpath(os.path.dirname(path))
    try:
        why = _why_not(os.lstat(os.path.join(above, os.path.basename(path))), False)
    except OSError as error:
        return error.strerror or str(error)
    return why_not_within(above) if why is None else why


def why_not_within(path: str) -> str | None:
    """Say why others may put another in place of what lies in a directory, whose path has no links; None if they cannot."""
    try:
        for above in (path, *map(str, Path(path).parents)):
            why = _why_not(os.lstat(above), True)
            if why is not None:
                return f"{above} above it is {why}"
    except OSError as error:
        return error.strerror or str(error)
    return None


def why_not_file(status: os.stat_result) -> str | None:
    """Say why one file, whose own status this is, may be another user's; None if it cannot."""
    if not stat.S_ISREG(status.st_mode):
        return "not a regular file"
    return _why_not_ours(status, {0, os.geteuid()})


def _why_not(status: os.stat_result, above: bool) -> str | None:
    if stat.S_ISLNK(status.st_mode):
        return "a symbolic link"
    if not stat.S_ISDIR(status.st_mode):
        return "not a directory"
    owners = {0, os.geteuid()} | (_outsiders() if above else set())
    if above and status.st_mode & stat.S_ISVTX and status.st_uid in owners:
        return None
    return _why_not_ours(status, owners)


def _why_not_ours(status: os.stat_result, owners: set[int]) -> str | None:
    if status.st_uid not in owners:
        return f"owned by user {status.st_uid}"
    if status.st_mode & stat.S_IWOTH:
        return "writable by all"
    if status.st_mode & stat.S_IWGRP and not _is_private(status.st_gid):
        return "writable by its group"
    return None


@cache
def _outsiders() -> set[int]:
    """The user as whom files show whose owner, root among them, has no number in our user namespace; none if there is
    only one namespace."""
    try:
        with open("/proc/self/uid_map", encoding="ascii") as file:
            if file.read().split() == ["0", "0", str(2**32 - 1)]:
                return set()
        with open("/proc/sys/kernel/overflowuid", encoding="ascii") as file:
            return {int(file.read())}
    except (OSError, ValueError):
        return set()


@cache
def _is_private(group: int) -> bool:
    """Tell whether this is the group of our user alone, as many systems give each user one."""
    try:
        us, entry = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except KeyError:
        return False
    return us.pw_gid == group and us.pw_name == entry.gr_name and set(entry.gr_mem) <= {us.pw_name}
