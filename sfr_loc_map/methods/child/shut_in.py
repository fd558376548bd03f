"""Shuts off a command from files and network: `python shut_in.py RULES COMMAND...`; requires nothing but Linux.

RULES are JSON: folders whose `names` may be listed, paths that may be read (`read`), and paths that may be written as
well (`write`). Paths that do not exist are ignored. The command runs in a child process under a Landlock domain (kernel
5.13), which requires no privilege. The first line on standard output is JSON: process number of the command, and what
the process is shut off from.

This process stays behind as the supervisor. Descendants of the command that lose their parent become its children. When
the command has ended, the supervisor kills them all and ends as the command did. docs/decisions/0010-isolation.md.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
import struct
import sys

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER, PR_SET_NO_NEW_PRIVS = 1, 36, 38
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # numbers of the calls, on every architecture
RIGHTS_BY_ABI = (13, 14, 15, 15, 16)  # number of rights on files that a version of Landlock has
EXECUTE, WRITE_FILE, READ_FILE, READ_DIR, TRUNCATE, IOCTL_DEV = (1 << bit for bit in (0, 1, 2, 3, 14, 15))
MAKE_DEVICES, MAKE_LINKS = 1 << 6 | 1 << 10 | 1 << 11, 1 << 12  # named pipes among them: a reader would block
OF_FILES = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE | IOCTL_DEV
READ = EXECUTE | READ_FILE | READ_DIR
TCP, TCP_ABI = 3, 4  # rights to bind and to connect, and the version of Landlock that has them
SCOPES, SCOPES_ABI = 3, 6  # signals and abstract sockets, likewise
LARGEST_FILE = 4_000_000_000  #: Bytes. Bounds what a command that writes for ever can take of a disk.
LIBC = ctypes.CDLL(None, use_errno=True)


def _checked(result: int, what: str) -> int:
    if result < 0:
        raise OSError(f"{what}: {os.strerror(ctypes.get_errno())}")
    return result


def shut_off(names: list[str], read: list[str], write: list[str]) -> list[str]:
    """Restrict this process and its descendants; return what they are shut off from. OSError without Landlock."""
    abi = _checked(LIBC.syscall(CREATE_RULESET, None, 0, 1), "Landlock")
    rights_on_files = (1 << RIGHTS_BY_ABI[min(abi, len(RIGHTS_BY_ABI)) - 1]) - 1
    attributes = struct.pack("=QQQ", rights_on_files, TCP * (abi >= TCP_ABI), SCOPES * (abi >= SCOPES_ABI))
    ruleset = _checked(LIBC.syscall(CREATE_RULESET, attributes, len(attributes), 0), "Landlock")
    for paths, rights in ((names, READ_DIR), (read, READ), (write, ~(MAKE_DEVICES | MAKE_LINKS))):
        for path in paths:
            try:
                place = os.open(path, os.O_PATH)
            except OSError:
                continue
            allowed = rights & rights_on_files & (-1 if os.path.isdir(path) else OF_FILES)
            rule = struct.pack("=Qi", allowed, place)
            _checked(LIBC.syscall(ADD_RULE, ruleset, 1, rule, 0), f"Landlock, {path}")
            if path == "/proc/self":
                os.set_inheritable(place, True)  # the kernel drops the rule with the last reference to the folder
            else:
                os.close(place)
    _checked(LIBC.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), "no_new_privs")
    _checked(LIBC.capset(struct.pack("=Ii", 0x20080522, 0), struct.pack("=6I", *[0] * 6)), "capabilities")
    _checked(LIBC.syscall(RESTRICT_SELF, ruleset, 0), "Landlock")
    os.close(ruleset)
    return ["files", "TCP"] if abi >= TCP_ABI else ["files"]


def supervise(command: int) -> None:
    """Wait for the command, kill what it has left, and end as the command did."""
    signal.signal(signal.SIGTERM, lambda *_: os.kill(command, signal.SIGKILL))
    for stream in (0, 1, 2):
        os.close(stream)  # the end of the command is the end of its streams
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


def main() -> None:
    """Start the supervised child, shut it off, report what could be done, and become the command."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    LIBC.prctl(PR_SET_CHILD_SUBREAPER, 1)
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if command := os.fork():
        supervise(command)
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST_FILE, LARGEST_FILE))
    text, *words = sys.argv[1:]
    rules = json.loads(text)
    try:
        isolation = ", ".join(shut_off(rules["names"], rules["read"], rules["write"]))
    except OSError as error:
        isolation = f"not files ({error})"
    print(json.dumps({"process": os.getpid(), "isolation": isolation}), flush=True)
    os.execv(words[0], words)


if __name__ == "__main__":
    main()
