"""Restart files: all that a run needs to go on with the same bits, whole or not at all, with a checksum.

A run keeps its multigrid hierarchies over many steps. A file does not hold them, they are ten times as large as the
state; it holds where they came from: the state and the step in which each was built. A restart takes these steps again,
and the hierarchies come out with the same bits.
"""

import hashlib
import json
import zipfile
import zlib
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from .output import replacing

NAME = "restart.npz"
VERSION = 3


class RestartError(ValueError):
    """A restart file that cannot be used: the file, what is wrong, what to do."""


@dataclass(frozen=True)
class Saved:
    """A run between two steps.

    state: step.State; origins: {name of a hierarchy: (state before the step in which it was built, length of that step,
    s, iterations of its first use)}; record: [(time, integral)] of the test for a steady state (steady.Steady.kept).
    """

    state: object
    origins: dict = field(default_factory=dict)
    record: tuple = ()


def save(path, saved):
    """A `Saved` as an npz, written whole or not at all."""
    arrays, meta = {}, {"version": VERSION, "origins": {}}
    states = [saved.state]
    for name, (state, dt, first) in saved.origins.items():
        if not any(state is s for s in states):
            states.append(state)
        meta["origins"][name] = [next(k for k, s in enumerate(states) if s is state), dt, first]
    for k, state in enumerate(states):
        for name, value in _fields(state).items():
            if isinstance(value, np.ndarray) and value.dtype.kind == "f" and not np.isfinite(value).all():
                raise RestartError(f"{path}: {name} is not finite; nothing was written")
            arrays[f"state{k}.{name}"] = np.asarray(value)
    arrays["record"] = np.array(saved.record, dtype=float).reshape(-1, 2)
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays, sha256=np.frombuffer(_digest(arrays), dtype=np.uint8))


def load(path, like):
    """The `Saved` of a restart file, for the scene of the state `like`. Raises RestartError."""
    path = Path(path)
    if not path.is_file():
        raise RestartError(f"{path}: there is no restart file; run the case anew")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        whole = arrays.pop("sha256").tobytes() == _digest(arrays)
        meta = json.loads(arrays["meta"].tobytes())
        version = meta["version"]
    # zipfile, zlib and numpy raise all of these for broken bytes
    except (OSError, KeyError, ValueError, EOFError, TypeError, AttributeError, NotImplementedError, RuntimeError,
            MemoryError, OverflowError, SyntaxError, zipfile.BadZipFile, zlib.error) as problem:
        raise RestartError(f"{path}: is no restart file of ours, or damaged ({problem}); run the case anew") from None
    if not whole:
        raise RestartError(f"{path}: is damaged (its checksum is wrong); run the case anew")
    if version != VERSION:
        raise RestartError(f"{path}: was written by another version of isph; run the case anew")
    states = {}
    for k in {0, *(origin[0] for origin in meta["origins"].values())}:
        found = {name.partition(".")[2]: v for name, v in arrays.items() if name.startswith(f"state{k}.")}
        states[k] = type(like)(**{name: v.item() if v.ndim == 0 else v for name, v in found.items()})
    _check_fits(path, states[0], like)
    origins = {name: (states[k], dt, first) for name, (k, dt, first) in meta["origins"].items()}
    return Saved(states[0], origins, tuple(map(tuple, arrays["record"].tolist())))


def _fields(state):
    """{name: value} of a state, without what it does not have."""
    return {f.name: getattr(state, f.name) for f in fields(state) if getattr(state, f.name) is not None}


def _check_fits(path, state, like):
    found, wanted = _fields(state), _fields(like)
    for name in sorted(found.keys() | wanted.keys()):
        here, there = (np.shape(f[name]) if name in f else None for f in (found, wanted))
        if here != there:
            what = f"{name} has the shape {here}, the case needs {there}"
            if name in ("drift", "push"):
                what = "one of the file and the case holds a superficial velocity, the other does not"
            raise RestartError(f"{path}: {what}; restart with the case that wrote it")


def _digest(arrays):
    """SHA-256 over names, types, shapes and bytes."""
    total = hashlib.sha256()
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name])
        total.update(f"{name} {values.dtype.str} {values.shape}\n".encode())
        total.update(values)
    return total.digest()
