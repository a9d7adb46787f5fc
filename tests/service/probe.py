"""Tries from inside the service's sandbox what a taken-over gateway would try; writes what it could do as JSON.

Run as ExecStartPre of the unit: the same user, mounts, filters and limits, and nothing of the program itself.
"""

import ctypes
import errno
import json
import mmap
import os
import socket
import sys

libc = ctypes.CDLL(None, use_errno=True)


def attempt(act):
    """Name of the error with which it was refused; "done" where it was not."""
    try:
        act()
    except OSError as error:
        return errno.errorcode.get(error.errno or 0, str(error))
    return "done"


def call(name, *arguments):
    """Act that calls the C library."""

    def act():
        if getattr(libc, name)(*arguments) < 0:
            raise OSError(ctypes.get_errno(), name)

    return act


def write(path):
    def act():
        with open(path, "w") as file:
            file.write("x")

    return act


def suid(path):
    def act():
        write(path)()
        os.chmod(path, 0o4755)

    return act


def family(number, kind=socket.SOCK_RAW, protocol=0):
    return lambda: socket.socket(number, kind, protocol).close()


state = os.environ["STATE_DIRECTORY"]
found = {
    "write state": attempt(write(f"{state}/probe.txt")),
    "write etc": attempt(write("/etc/bms-gateway/gateway.toml")),
    "write program": attempt(write("/opt/bms-gateway/x")),
    "write root": attempt(write("/x")),
    "write var": attempt(write("/var/lib/x")),
    "write sys": attempt(write("/sys/kernel/uevent_helper")),
    "write sysctl": attempt(write("/proc/sys/kernel/hostname")),
    "write cgroup": attempt(write("/sys/fs/cgroup/cgroup.procs")),
    "see home": attempt(lambda: os.listdir("/home")),
    "see root": attempt(lambda: os.listdir("/root")),
    "see process 1": attempt(lambda: os.stat("/proc/1")),
    "see memory": attempt(lambda: os.stat("/dev/mem")),
    "see host's tmp": "done" if os.path.exists("/tmp/probe-of-the-host") else "ENOENT",
    "can": attempt(family(socket.AF_CAN, socket.SOCK_RAW, 1)),
    "netlink": attempt(family(socket.AF_NETLINK)),
    "packet": attempt(family(socket.AF_PACKET)),
    "raw ip": attempt(family(socket.AF_INET, socket.SOCK_RAW, 1)),
    "vsock": attempt(family(40, socket.SOCK_STREAM)),
    "alg": attempt(family(38, socket.SOCK_SEQPACKET)),
    "unshare user": attempt(call("unshare", 0x10000000)),
    "unshare net": attempt(call("unshare", 0x40000000)),
    "mount": attempt(call("mount", b"none", b"/tmp", b"tmpfs", 0, None)),
    "set clock": attempt(call("settimeofday", ctypes.create_string_buffer(b"\1" + bytes(15)), None)),
    "set hostname": attempt(call("sethostname", b"x", 1)),
    "setuid": attempt(lambda: os.setuid(0)),
    "chown": attempt(lambda: os.chown(f"{state}/probe.txt", 0, 0)),
    "suid file": attempt(suid(f"{state}/suid")),
    "real time": attempt(lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))),
    "trace": attempt(call("ptrace", 16, 1, None, None)),
    "reboot": attempt(call("reboot", 0x89ABCDEF)),
    "code in data": attempt(
        lambda: mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC).close()
    ),
    "user": os.getuid(),
}
with open("/proc/self/status") as file:
    status = dict(line.rstrip("\n").split(":\t", 1) for line in file if ":\t" in line)
found |= {k: status[k] for k in ("CapEff", "CapPrm", "CapBnd", "CapAmb", "NoNewPrivs", "Seccomp", "Umask")}
with open(sys.argv[1] if len(sys.argv) > 1 else f"{state}/probe.json", "w") as file:
    json.dump(found, file)
