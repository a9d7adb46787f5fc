"""A disk whose power may fail: the system calls of a program are recorded, and every directory that a cut could leave
behind is built from them.

What POSIX and the usual journals promise, and no more: written bytes are safe once their file was synced; names are
safe once their directory was synced; until then any beginning of the list of renames, links and unlinks may be on the
disk, in their order, and of unsynced bytes anything: none, a part, zeros in place of the rest, zeros in place of all,
noise. Kinds that also break the order of the names are tried beside (`reordered`).
"""

import itertools
import os
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Inode:
    """Content as written, and how much of it was synced."""

    content: bytes
    synced: int


@dataclass
class Disk:
    """What the calls did so far: names that are safe, names in force, and the changes in between."""

    root: str
    safe: dict[str, Inode]
    pending: list[tuple] = field(default_factory=list)  # ("name", path, inode) or ("gone", path)

    def names(self, changes):
        now = dict(self.safe)
        for kind, path, inode in changes:
            if kind == "name":
                now[path] = inode
            else:
                now.pop(path, None)
        return now

    def now(self):
        return self.names(self.flat(self.pending))

    @staticmethod
    def flat(groups):
        return [change for group in groups for change in group]

    @classmethod
    def of(cls, folder: Path):
        """A disk on which all of `folder` is safe."""
        files = {}
        for file in sorted(folder.rglob("*")):
            name = str(file.relative_to(folder))
            files[name] = DIRECTORY if file.is_dir() else Inode(file.read_bytes(), file.stat().st_size)
        return cls(str(folder), files)

    def states(self, *, reordered=False, sector=512):
        """Every directory a cut at this moment could leave: mapping of name to bytes, None for a directory."""
        orders = [self.pending[:k] for k in range(len(self.pending) + 1)]
        if reordered and len(self.pending) <= 6:
            orders += [
                [g for g, keep in zip(self.pending, kept, strict=True) if keep]
                for kept in itertools.product((False, True), repeat=len(self.pending))
            ]
        seen = set()
        for groups in orders:
            names = self.names(self.flat(groups))
            loose = [p for p, i in names.items() if i is not DIRECTORY and i.synced < len(i.content)]
            for contents in itertools.product(*(remains(names[p], sector) for p in loose)):
                state = {p: None if i is DIRECTORY else i.content for p, i in names.items()}
                state |= dict(zip(loose, contents, strict=True))
                key = tuple(sorted(state.items()))
                if key not in seen:
                    seen.add(key)
                    yield state


DIRECTORY = Inode(b"", 0)


def remains(inode: Inode, sector: int):
    """What may be left of a file of which a part was not synced."""
    safe, loose = inode.content[: inode.synced], inode.content[inode.synced :]
    n = len(loose)
    cuts = sorted(
        {0, 1, n // 4, n // 2, n - 1, n} | set(range(0, n, sector)) | set(range(0, min(n, 96), max(7, sector // 40)))
    )
    whole = [safe + loose[:k] for k in cuts]
    zeros = [safe + loose[:k] + bytes(n - k) for k in cuts if k < n]
    noise = safe + bytes((b * 31 + 7) % 256 for b in loose)
    hole = safe + bytes(n // 2) + loose[n // 2 :]
    return list(dict.fromkeys([*whole, *zeros, noise, hole]))


class Recorder:
    """Watches the calls that change a disk, in this process, below one folder."""

    CALLS = ("open", "write", "fsync", "close", "replace", "unlink", "mkdir")

    def __init__(self, folder: Path):
        self.folder = folder
        self.disk = Disk.of(folder)
        self.calls: list[str] = []
        self.handles: dict[int, object] = {}
        self.after: list[tuple[str, Disk]] = []
        self.real = {name: getattr(os, name) for name in self.CALLS}

    def _mine(self, path):
        text = os.fspath(path)
        return text == str(self.folder) or text.startswith(f"{self.folder}/")

    def _name(self, path):
        return os.path.relpath(os.fspath(path), self.folder)

    def _done(self, call: str):
        """Note a call and the disk as it is right after it."""
        self.calls.append(call)
        copies = {id(i): Inode(i.content, i.synced) for i in self._inodes()}
        copies[id(DIRECTORY)] = DIRECTORY
        swap = lambda names: {p: copies[id(i)] for p, i in names.items()}  # noqa: E731
        pending = [[(k, p, copies[id(i)] if i is not None else None) for k, p, i in g] for g in self.disk.pending]
        self.after.append((call, Disk(str(self.folder), swap(self.disk.safe), pending)))

    def _inodes(self):
        yield from self.disk.safe.values()
        yield from (i for g in self.disk.pending for _, _, i in g if i is not None)

    def open(self, path, flags, mode=0o777, **more):
        handle = self.real["open"](path, flags, mode, **more)
        if self._mine(path):
            name, names = self._name(path), self.disk.now()
            if flags & os.O_DIRECTORY or os.path.isdir(path):
                self.handles[handle] = name
            elif flags & (os.O_WRONLY | os.O_RDWR):
                assert not flags & os.O_TRUNC, "the model has no truncation"
                if name not in names:
                    self.disk.pending.append([("name", name, Inode(b"", 0))])
                self.handles[handle] = self.disk.now()[name]
                self._done(f"open {name}")
        return handle

    def write(self, handle, data):
        n = self.real["write"](handle, data)
        inode = self.handles.get(handle)
        if isinstance(inode, Inode):
            inode.content += bytes(memoryview(data)[:n])
            self._done("write")
        return n

    def fsync(self, handle):
        self.real["fsync"](handle)
        at = self.handles.get(handle)
        if isinstance(at, Inode):
            at.synced = len(at.content)
        elif at is not None:
            mine = [g for g in self.disk.pending if all(self._folder(p) == at for _, p, _ in g)]
            self.disk.safe = self.disk.names(self.disk.flat(mine))
            self.disk.pending = [g for g in self.disk.pending if g not in mine]
        else:
            return
        self._done("fsync")

    @staticmethod
    def _folder(path):
        return os.path.dirname(path) or "."

    def close(self, handle):
        self.handles.pop(handle, None)
        self.real["close"](handle)

    def replace(self, a, b, **more):
        self.real["replace"](a, b, **more)
        if self._mine(a):
            inode = self.disk.now()[self._name(a)]
            self.disk.pending.append([("gone", self._name(a), None), ("name", self._name(b), inode)])
            self._done(f"rename {self._name(a)} {self._name(b)}")

    def unlink(self, path, **more):
        self.real["unlink"](path, **more)
        if self._mine(path):
            self.disk.pending.append([("gone", self._name(path), None)])
            self._done(f"unlink {self._name(path)}")

    def mkdir(self, path, mode=0o777, **more):
        self.real["mkdir"](path, mode, **more)
        if self._mine(path):
            self.disk.pending.append([("name", self._name(path), DIRECTORY)])
            self._done(f"mkdir {self._name(path)}")

    @contextmanager
    def watching(self):
        for name in self.CALLS:
            setattr(os, name, getattr(self, name))
        try:
            yield self
        finally:
            for name in self.CALLS:
                setattr(os, name, self.real[name])
        self.check()

    def check(self):
        """What was recorded is all that happened: replayed in full it gives the folder as it is."""
        there = Disk.of(self.folder).safe
        now = self.disk.now()
        assert {p: i.content for p, i in now.items()} == {p: i.content for p, i in there.items()}


def build(state: dict, folder: Path) -> None:
    """Lay a state out in an empty folder; a name whose directory did not survive is lost with it."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in sorted(state.items()):
        file = folder / name
        if content is None:
            file.mkdir(exist_ok=True)
        elif file.parent.is_dir():
            file.write_bytes(content)
