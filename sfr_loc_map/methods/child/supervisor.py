"""Runs a command that can use only given paths and no sockets: `python supervisor.py COMMAND...`.

The first line on standard input is JSON: the `Rules` of the command. The command runs in a child process in a Landlock
domain (Linux 5.13) and under a filter of system calls (x86-64 and AArch64). Neither requires privileges. The first line
on standard output is JSON: `Started`. The streams then belong to the command. This program requires only Linux.

This process remains as the supervisor, and adopts orphaned descendants of the command. When the command has ended, the
supervisor kills all descendants and exits with the status of the command. See docs/decisions/0010-isolation.md.
"""

from __future__ import annotations

import ctypes
import json
import os
import platform
import resource
import signal
import struct
import sys
from typing import TypedDict

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER, PR_SET_NO_NEW_PRIVS = 1, 36, 38
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # system call numbers, on every architecture
RIGHTS_BY_ABI = (13, 14, 15, 15, 16)  # number of file rights of each Landlock ABI version
EXECUTE, WRITE_FILE, READ_FILE, READ_DIR, TRUNCATE, IOCTL_DEV = (1 << bit for bit in (0, 1, 2, 3, 14, 15))
MAKE_DEVICES, MAKE_LINKS = 1 << 6 | 1 << 10 | 1 << 11, 1 << 12  # includes named pipes, which would block a reader
OF_FILES = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE | IOCTL_DEV
READ = EXECUTE | READ_FILE | READ_DIR
TCP, TCP_ABI = 3, 4  # rights to bind and connect, and the first ABI version with them
SCOPES, SCOPES_ABI = 3, 6  # signals and abstract sockets, and the first ABI version with them
LARGEST_FILE = 4_000_000_000  #: Bytes. Limits the disk use of a command that writes endlessly.
CALLS = {
    # seccomp; socket, setsockopt, sendmsg, sendmmsg; shmget, semget, msgget, mq_open; add_key, request_key, keyctl;
    # setxattr, lsetxattr, fsetxattr, removexattr, lremovexattr, fremovexattr
    "x86_64": ((0xC000003E, 317), (41, 54, 46, 307, 29, 64, 68, 240, 248, 249, 250, 188, 189, 190, 197, 198, 199)),
    "aarch64": ((0xC00000B7, 277), (198, 208, 211, 269, 194, 190, 186, 180, 217, 218, 219, 5, 6, 7, 14, 15, 16)),
}
"""By architecture: its number and that of the system call seccomp, and the numbers of the refused system calls.

A new socket could reach other processes, which could pass open files. A larger buffer (`setsockopt`) holds memory that
is counted for no process, and a message can hold open files (`sendmsg`). Memory of System V, message queues, keys and
extended attributes of files outlive their process."""
IO_URING_SETUP, MEMFD_SECRET, SETXATTRAT, REMOVEXATTRAT, FILE_SETATTR = 425, 447, 463, 466, 469
"""Refused system calls, on every architecture. The first opens sockets without the system calls in `CALLS`. The second
allocates memory that the kernel reports for no process. The others write attributes of files."""
WITHOUT_EFFECT = {
    # chmod, fchmod, fchmodat; chown, fchown, lchown, fchownat; utime, utimes, futimesat, utimensat
    "x86_64": (90, 91, 268, 92, 93, 94, 260, 132, 235, 261, 280),
    "aarch64": (52, 53, 55, 54, 88),
}
"""System calls that succeed without an effect, so that programs that copy a file with its mode and times work. Modes,
owners and times can be set for any file of the user, and outlive the process."""
FCHMODAT2 = 452  #: Likewise, on every architecture.
SET_FILTER, ALLOW_SPECULATION = 1, 4  #: The flag avoids a slow-down on kernels before 5.16.
LOAD, JUMP_IF_EQUAL, JUMP_IF_GREATER_EQUAL, RETURN = 0x20, 0x15, 0x35, 0x06  #: Instructions of the filter.
ALLOWED, FIRST_OF_X32 = 0x7FFF0000, 0x40000000
REFUSED, IGNORED = 0x00050001, 0x00050000  #: The errors "operation not permitted" and none, without the system call.
LIBC = ctypes.CDLL(None, use_errno=True)


class Rules(TypedDict):
    """Paths that the command may use; missing paths are ignored."""

    names: list[str]  #: Folders that may be listed.
    read: list[str]  #: Paths that may be read.
    write: list[str]  #: Paths that may be read and written.


class Started(TypedDict):
    """Answer to the rules."""

    process: int  #: Process id of the command.
    isolation: str  #: Restrictions in force.
    can_read_all_files: bool  #: Whether files are not restricted.


def _checked(result: int, what: str) -> int:
    if result < 0:
        raise OSError(f"{what}: {os.strerror(ctypes.get_errno())}")
    return result


def restrict(rules: Rules) -> list[str]:
    """Restrict this process and its descendants; return the restrictions. OSError without Landlock."""
    abi = _checked(LIBC.syscall(CREATE_RULESET, None, 0, 1), "Landlock")
    rights_on_files = (1 << RIGHTS_BY_ABI[min(abi, len(RIGHTS_BY_ABI)) - 1]) - 1
    attributes = struct.pack("=QQQ", rights_on_files, TCP * (abi >= TCP_ABI), SCOPES * (abi >= SCOPES_ABI))
    ruleset = _checked(LIBC.syscall(CREATE_RULESET, attributes, len(attributes), 0), "Landlock")
    for paths, rights in (
        (rules["names"], READ_DIR),
        (rules["read"], READ),
        (rules["write"], ~(MAKE_DEVICES | MAKE_LINKS)),
    ):
        for path in paths:
            try:
                place = os.open(path, os.O_PATH)
            except OSError:
                continue
            allowed = rights & rights_on_files & (-1 if os.path.isdir(path) else OF_FILES)
            rule = struct.pack("=Qi", allowed, place)
            _checked(LIBC.syscall(ADD_RULE, ruleset, 1, rule, 0), f"Landlock, {path}")
            if path == "/proc/self":
                os.set_inheritable(place, True)  # the rule ends with the last reference to the folder
            else:
                os.close(place)
    _checked(LIBC.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), "no_new_privs")
    _checked(LIBC.capset(struct.pack("=Ii", 0x20080522, 0), struct.pack("=6I", *[0] * 6)), "capabilities")
    _checked(LIBC.syscall(RESTRICT_SELF, ruleset, 0), "Landlock")
    os.close(ruleset)
    return ["files", "TCP"] if abi >= TCP_ABI else ["files"]


def refuse_calls() -> list[str]:
    """Filter the system calls of `CALLS` and `WITHOUT_EFFECT`; return the restrictions, empty if this is impossible.

    A program of another architecture, for example of 32 bits, may make no system call at all.
    """
    if platform.machine() not in CALLS:
        return []
    (architecture, seccomp), refused = CALLS[platform.machine()]
    of_all = (IO_URING_SETUP, MEMFD_SECRET, SETXATTRAT, REMOVEXATTRAT, FILE_SETATTR)
    after = dict.fromkeys((*refused, *of_all), 0)  # lines from that of REFUSED to that of the result
    after |= dict.fromkeys((*WITHOUT_EFFECT[platform.machine()], FCHMODAT2), 1)
    count = len(after)
    lines = [(LOAD, 0, 0, 4), (JUMP_IF_EQUAL, 0, count + 3, architecture)]
    lines += [(LOAD, 0, 0, 0), (JUMP_IF_GREATER_EQUAL, count + 1, 0, FIRST_OF_X32)]
    lines += [(JUMP_IF_EQUAL, count - place + after[number], 0, number) for place, number in enumerate(after)]
    lines += [(RETURN, 0, 0, ALLOWED), (RETURN, 0, 0, REFUSED), (RETURN, 0, 0, IGNORED)]
    text = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *line) for line in lines))
    program = struct.pack("@HP", len(lines), ctypes.addressof(text))
    LIBC.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    is_refused = LIBC.syscall(seccomp, SET_FILTER, ALLOW_SPECULATION, program) == 0
    return ["sockets", "IPC"] if is_refused else []


def supervise(command: int) -> None:
    """Wait for the command, kill its remaining descendants, and exit with its status."""
    signal.signal(signal.SIGTERM, lambda *_: os.kill(command, signal.SIGKILL))
    for stream in (0, 1, 2):
        os.close(stream)  # so that the streams end with the command
    ended, status = os.wait()
    while ended != command:
        ended, status = os.wait()
    while left := _children():
        for process in left:
            os.kill(process, signal.SIGKILL)
        os.wait()
    if os.WIFSIGNALED(status):
        signal.signal(os.WTERMSIG(status), signal.SIG_DFL)
        os.kill(os.getpid(), os.WTERMSIG(status))
    os._exit(os.WEXITSTATUS(status))


def _children() -> list[int]:
    with open(f"/proc/self/task/{os.getpid()}/children", encoding="ascii") as stream:
        return [int(number) for number in stream.read().split()]


def _rules() -> Rules:
    """Read the rules without a buffer, because the lines after them are for the command."""
    line = b""
    while not line.endswith(b"\n"):
        part = os.read(0, 65536)
        if not part:
            raise SystemExit("standard input ended before the first line was complete: a line of JSON is required")
        line += part
    rules: Rules = json.loads(line)
    return rules


def main() -> None:
    """Fork. The parent supervises; the child restricts itself, reports the restrictions and becomes the command."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    LIBC.prctl(PR_SET_CHILD_SUBREAPER, 1)
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if command := os.fork():
        supervise(command)
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST_FILE, LARGEST_FILE))
    words = sys.argv[1:]
    can_read_all_files = False
    try:
        restrictions = restrict(_rules())
    except OSError as error:
        can_read_all_files = True
        restrictions = [f"not files ({error})"]
    isolation = ", ".join([*restrictions, *refuse_calls()])
    started: Started = {"process": os.getpid(), "isolation": isolation, "can_read_all_files": can_read_all_files}
    print(json.dumps(started), flush=True)
    os.execv(words[0], words)


if __name__ == "__main__":
    main()
