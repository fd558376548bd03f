"""Shuts its process in and becomes another: `python shut_in.py RULES COMMAND...`; needs nothing but Linux.

RULES are JSON: folders whose `names` may be listed, what may be read (`read`), and written as well (`write`); paths
that are not there are left out; how large shared memory of its own may grow (`shared_memory`, bytes), the `folder` in
it that stays. Files are shut off by Landlock (kernel 5.13), which needs no privilege. In a PID namespace, where the
kernel gives one, other processes cannot be reached, and all that were started end with the command. Capabilities are
dropped. The command can still start processes and open network connections: no rule here concerns the network. A line
of JSON says what could be done, before anything else is written to standard output; `levels` is how many processes are
between this one and the command.
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
CLONE_NEWNS, CLONE_NEWUSER, CLONE_NEWPID = 0x00020000, 0x10000000, 0x20000000
MS_BIND, MS_REC, MS_PRIVATE = 0x1000, 0x4000, 0x40000
SHARED_MEMORY = "/dev/shm"
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # numbers of the calls, on every architecture
RIGHTS_BY_ABI = (13, 14, 15, 15, 16)  # how many rights on files a version of Landlock knows
EXECUTE, WRITE_FILE, READ_FILE, READ_DIR, TRUNCATE, IOCTL_DEV = (1 << bit for bit in (0, 1, 2, 3, 14, 15))
MAKE_DEVICES, MAKE_LINKS = 1 << 6 | 1 << 10 | 1 << 11, 1 << 12  # fifos among them: a reader would wait for ever
OF_FILES = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE | IOCTL_DEV
READ = EXECUTE | READ_FILE | READ_DIR
SCOPES = 3  # signals and abstract sockets, from version 6 on
LIBC = ctypes.CDLL(None, use_errno=True)


def _checked(result: int, what: str) -> int:
    if result < 0:
        raise OSError(f"{what}: {os.strerror(ctypes.get_errno())}")
    return result


def shut_off_files(names: list[str], read: list[str], write: list[str]) -> None:
    """Let this process, and all that it starts, open nothing but what is named; OSError where that cannot be."""
    abi = _checked(LIBC.syscall(CREATE_RULESET, None, 0, 1), "Landlock")
    known = (1 << RIGHTS_BY_ABI[min(abi, len(RIGHTS_BY_ABI)) - 1]) - 1
    attributes = struct.pack("=QQQ", known, 0, SCOPES if abi >= 6 else 0)
    ruleset = _checked(LIBC.syscall(CREATE_RULESET, attributes, len(attributes), 0), "Landlock")
    for paths, rights in ((names, READ_DIR), (read, READ), (write, ~(MAKE_DEVICES | MAKE_LINKS))):
        for path in paths:
            try:
                place = os.open(path, os.O_PATH)
            except OSError:
                continue
            allowed = rights & known & (-1 if os.path.isdir(path) else OF_FILES)
            rule = struct.pack("=Qi", allowed, place)
            _checked(LIBC.syscall(ADD_RULE, ruleset, 1, rule, 0), f"Landlock, {path}")
            if path == "/proc/self":
                os.set_inheritable(place, True)  # the kernel forgets what it is in time, unless it is held
            else:
                os.close(place)
    _checked(LIBC.syscall(RESTRICT_SELF, ruleset, 0), "Landlock")
    os.close(ruleset)


def drop_privileges() -> None:
    """Drop all capabilities for good."""
    _checked(LIBC.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), "no_new_privs")
    _checked(LIBC.capset(struct.pack("=Ii", 0x20080522, 0), struct.pack("=6I", *[0] * 6)), "capabilities")


def enter_namespace() -> None:
    """Let the next process that this one starts be the first of a PID namespace, mounts apart; else OSError."""
    ids = (("uid_map", os.getuid()), ("gid_map", os.getgid()))
    _checked(LIBC.unshare(CLONE_NEWUSER | CLONE_NEWPID | CLONE_NEWNS), "PID namespace")
    for name, text in (("setgroups", "deny"), *((name, f"{number} {number} 1") for name, number in ids)):
        with open(f"/proc/self/{name}", "w", encoding="ascii") as stream:
            stream.write(text)


def make_shared_memory(size: int, folder: str) -> None:
    """Mount shared memory of its own, with a folder of what was there; OSError where that cannot be."""
    place, here = os.open(folder, os.O_PATH), os.getcwd()
    _mount(None, "/", None, MS_REC | MS_PRIVATE, None)
    _mount("tmpfs", SHARED_MEMORY, "tmpfs", 0, f"size={size},mode=1777")
    if folder.startswith(f"{SHARED_MEMORY}/"):
        os.makedirs(folder)
        _mount(f"/proc/self/fd/{place}", folder, None, MS_BIND, None)
    os.close(place)
    os.chdir(here)


def _mount(source: str | None, target: str, kind: str | None, flags: int, options: str | None) -> None:
    words = [None if text is None else text.encode() for text in (source, target, kind, options)]
    _checked(LIBC.mount(*words[:3], ctypes.c_ulong(flags), words[3]), f"mount {target}")


def _wait_for(process: int) -> int:
    """Reap what ends until a process has; return its exit code, 128 and more for a signal, as a shell does."""
    while True:
        ended, status = os.wait()
        if ended == process:
            return 128 + os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)


def _first_of_namespace() -> None:
    """Stay behind as the first process of the namespace, with which all others end, and return in the second."""
    if first := os.fork():
        code = _wait_for(first)
        if code > 128:  # ended as the command was
            signal.signal(code - 128, signal.SIG_DFL)
            os.kill(os.getpid(), code - 128)
        os._exit(code)
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if second := os.fork():
        for stream in (0, 1, 2):
            os.close(stream)
        os._exit(_wait_for(second))
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def main() -> None:
    """Shut in, say how well that went, become the command."""
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    text, *command = sys.argv[1:]
    rules = json.loads(text)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    done, missing, levels = [], [], 0

    def shut_off_processes() -> None:
        nonlocal levels
        _first_of_namespace()
        levels = 2

    for name, step in (
        ("a namespace", enter_namespace),
        ("shared memory", lambda: make_shared_memory(rules["shared_memory"], rules["folder"])),
        ("privileges", drop_privileges),
        ("processes", shut_off_processes),
        ("files", lambda: shut_off_files(rules["names"], rules["read"], rules["write"])),
    ):
        if name in ("shared memory", "processes") and "a namespace" not in done:
            continue
        try:
            step()
            done.append(name)
        except OSError as error:
            missing.append(f"{name} ({error})")
    if not levels:  # what is left behind stays a descendant; in a namespace it falls to the first process of that
        LIBC.prctl(PR_SET_CHILD_SUBREAPER, 1)
    print(
        json.dumps({"isolated": sorted({*done} - {"a namespace", "privileges"}), "missing": missing, "levels": levels}),
        flush=True,
    )
    os.execv(command[0], command)


if __name__ == "__main__":
    main()
