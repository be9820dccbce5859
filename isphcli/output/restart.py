"""Restart files: all that a run needs to go on with the same bits, whole or not at all, with a checksum.

A run keeps its multigrid hierarchies over many steps. A file does not hold them, they are ten times as large as the
state; it holds where they came from: the state and the step in which each was built. A restart takes these steps again,
and the hierarchies come out with the same bits.

It also holds the record of the case: the keys that place particles and walls (the scene), which a restart cannot
change, and all others that the flow depends on (the values), which it can; its changes are added to the record.
"""

from __future__ import annotations

import hashlib
import json
import re
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.blocks import Case, Time, Voxels, plain
from ..domain import reduce
from ..domain.communicator import current, on_first
from ..domain.exchange import deliver
from . import shared_npz
from .files import replacing

if TYPE_CHECKING:
    from ..flow.state import State

NAME = "restart.npz"
VERSION = 6  # of the format: one more whenever the content of the file changes its meaning
# arrays with a row per particle, of which each of several processes writes and reads its own
IN_SLABS = tuple(f"state0.{name}" for name in ("x", "u", "u_old", "p", "phi", "volume"))
# Keys of the scene; all others are values, but for those that change no flow (IDLE). A wall may move or slip otherwise.
SCENE = re.compile(r"geometry\b|initial\b|reservoirs\b|fluids$|particles\.(spacing|lattice|offset|jitter|seed)\b")
AT_WALLS = re.compile(r"geometry\.(walls|slip_length|shapes\[\d+\]\.(velocity|angular_velocity|slip_length))\b")
IDLE = re.compile(r"(title|flow|output|reference|refine|refine_budget)\b")


class RestartError(ValueError):
    """A restart file that cannot be used: the file, what is wrong, what to do."""


@dataclass(frozen=True)
class Saved:
    """A run between two steps.

    state: flow.state.State; origins: {name of a hierarchy: (state before the step in which it was built, length of that
    step, s, iterations of its first use)}; steady: [(time, integral)] of the test for a steady state
    (`steadiness.Steady`);
    record: that of the case, see `record_of`.
    """

    state: State
    origins: dict[str, tuple[State, float, int]] = field(default_factory=dict)
    steady: tuple[tuple[float, float], ...] = ()
    record: dict[str, Any] = field(default_factory=dict)


def save(path: str | Path, saved: Saved, record: Mapping[str, Any] | None = None) -> None:
    """A `Saved` with the record of its case as an npz, written whole or not at all.

    All processes write it together, the particles in the order of one process: they go to slabs of their numbers. Of
    several the hierarchies are left out.
    """
    origins: dict[str, list[Any]] = {}
    states = [saved.state]
    for name, (state, dt, first) in saved.origins.items() if current().size == 1 else ():
        if not any(state is s for s in states):
            states.append(state)
        origins[name] = [next(k for k, s in enumerate(states) if s is state), dt, first]
    arrays: dict[str, np.ndarray] = {}
    for k, state in enumerate(states):
        values = {name: np.asarray(value) for name, value in _fields(state).items()}
        for name, value in values.items():
            if value.dtype.kind == "f" and reduce.any_true(~np.isfinite(value)):
                raise RestartError(f"{path}: {name} is not finite; nothing was written")
        arrays |= {f"state{k}.{name}": value for name, value in values.items()}
    meta = {"version": VERSION, "origins": origins, "record": record or saved.record}
    arrays |= {"steady": np.array(saved.steady, dtype=float).reshape(-1, 2),
               "meta": np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)}
    counts: dict[str, int] = {}
    if current().size > 1:
        counts = _deal_in_slabs(arrays)
    with ExitStack() as written:
        # rank 0 makes the file and gives it its name in the end
        shared_npz.write(on_first(lambda: written.enter_context(replacing(path))), arrays, counts)
        on_first(written.close)


def _deal_in_slabs(arrays: dict[str, np.ndarray]) -> dict[str, int]:
    """Replaces arrays of the particles of this process by those of its slab, in the order of their numbers, which are
    taken out; returns how many there are of each on all processes."""
    number = arrays.pop("state0.number")
    count = reduce.number(number)
    names = [name for name in IN_SLABS if name in arrays]
    *slabs, number, _ = deliver(current().raw, shared_npz.in_slab_of(number, count),  # type: ignore[attr-defined]
                                *(arrays[name] for name in names), number)
    order = np.argsort(number)
    arrays |= {name: values[order] for name, values in zip(names, slabs)}
    return dict.fromkeys(names, count)


def require(path: str | Path) -> None:
    """Raises RestartError where there is no file."""
    if not Path(path).is_file():
        raise RestartError(f"{path}: there is no restart file; run the case anew")


def load(path: str | Path, like: State, record: Mapping[str, Any] | None = None) -> Saved:
    """The `Saved` of a restart file, for the scene of the state `like`, and of the record if that is given. Raises
    RestartError."""
    path, shared = Path(path), current().size > 1
    require(path)
    try:
        arrays, whole = shared_npz.read(path, IN_SLABS, lambda name: shared and name.startswith("state")
                                 and not name.startswith("state0."))
        meta = json.loads(arrays["meta"].tobytes())
        version = meta["version"]
    # zipfile, zlib and numpy raise all of these for broken bytes
    except (OSError, KeyError, ValueError, EOFError, TypeError, AttributeError, NotImplementedError, RuntimeError,
            MemoryError, OverflowError, SyntaxError, zipfile.BadZipFile, zlib.error) as problem:
        raise RestartError(f"{path}: is no restart file of ours, or damaged ({problem}); run the case anew") from None
    if version != VERSION:
        raise RestartError(f"{path}: was written by another version of isph (format {version!r}, here {VERSION}); go "
                           "on with that version, or run the case anew")
    if not whole:
        raise RestartError(f"{path}: is damaged (its checksum is wrong); run the case anew")
    if record is not None:
        _check_scene(path, meta.get("record", {}), record)
    if shared:  # hierarchies are built when they are needed
        meta["origins"] = {}
    states: dict[int, State] = {}
    for k in {0, *(origin[0] for origin in meta["origins"].values())}:
        found: dict[str, Any] = {
            name.partition(".")[2]: v for name, v in arrays.items() if name.startswith(f"state{k}.")}
        states[k] = type(like)(**{name: v.item() if v.ndim == 0 else v for name, v in found.items()})
    if shared:  # the numbers are the order of the file
        states[0] = replace(states[0], number=np.arange(*shared_npz.slab(reduce.number(states[0].x))))
    _check_fits(path, states[0], like)
    origins = {name: (states[k], dt, first) for name, (k, dt, first) in meta["origins"].items()}
    return Saved(states[0], origins, tuple(map(tuple, arrays["steady"].tolist())), meta.get("record", {}))


def _fields(state: State) -> dict[str, Any]:
    """{name: value} of a state, without members that are None."""
    return {f.name: getattr(state, f.name) for f in fields(state) if getattr(state, f.name) is not None}


def _check_fits(path: Path, state: State, like: State) -> None:
    found, wanted = _fields(state), _fields(like)
    for name in sorted((found.keys() | wanted.keys()) - {"number"}):
        here, there = (_shape(f[name]) if name in f else None for f in (found, wanted))
        if here != there:
            what = f"{name} has the shape {here}, the case needs {there}"
            if name == "pressure_gradient":
                what = "one of the file and the case holds a superficial velocity, the other does not"
            raise RestartError(f"{path}: {what}; restart with the case that wrote it")


def _shape(value: Any) -> tuple[int, ...]:
    """Shape of an array of all processes."""
    shape = np.shape(value)
    return shape if current().size == 1 or not shape else (reduce.number(value), *shape[1:])


# --- the record of the case --------------------------------------------------------------------------------------


def record_of(case: Case) -> dict[str, Any]:
    """The record of a case, in types of JSON: {"scene": {key: value}, "values": {key: value}, "changes": []}.

    Keys are those of the case file. A file that the scene is read from stands there as the SHA-256 of its bytes, an
    image as that of its voxels, whatever file holds them.
    """
    said = dict(_entries(plain(case.completed())))
    said["fluids"] = list(case.fluid_names)
    voxels = case.geometry.voxels
    if voxels is not None:
        from ..geometry.images.read import axes_of

        said["geometry.voxels.file"] = _image_digest(voxels)
        said["geometry.voxels.axes"] = axes_of(voxels.file, voxels.axes)
        for key in ("array", "shape", "dtype", "offset", "byte_order"):  # of the file, and not of its voxels
            said.pop(f"geometry.voxels.{key}", None)
    for k, shape in enumerate(case.geometry.shapes):
        if shape.spheres is not None and shape.spheres.file is not None:
            with open(shape.spheres.file, "rb") as file:
                said[f"geometry.shapes[{k}].spheres.file"] = hashlib.file_digest(file, "sha256").hexdigest()
    is_scene = {key: bool(SCENE.match(key)) and not AT_WALLS.match(key) for key in said}
    return {
        "scene": {key: value for key, value in said.items() if is_scene[key]},
        "values": {key: value for key, value in said.items() if not is_scene[key] and not IDLE.match(key)},
        "changes": [],
    }


def _image_digest(voxels: Voxels) -> str:
    """SHA-256 of type, shape and values of an image. Where several processes have its layers, rank 0, which looks,
    reads it layer by layer."""
    from ..scene.image_file import image_by_layers, image_of, shape_of

    def of_type(kind: np.dtype, shape: tuple[int, ...]) -> hashlib._Hash:
        return hashlib.sha256(f"image {kind.str} {shape}\n".encode())

    if current().size == 1:
        whole = np.ascontiguousarray(image_of(voxels).values)
        total = of_type(whole.dtype, whole.shape)
        total.update(whole.data)
        return total.hexdigest()
    kind = next(image_by_layers(voxels)).dtype
    while True:  # once more where labels behind the first layers need more bytes
        total, widest = of_type(kind, shape_of(voxels)), kind
        for values in image_by_layers(voxels):
            widest = np.result_type(values.dtype, widest)
            total.update(np.ascontiguousarray(values, kind).data)
        if widest == kind:
            return total.hexdigest()
        kind = widest


def _entries(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """(key, value) of what nested dicts, and lists of them, hold."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _entries(inner, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and any(isinstance(inner, dict) for inner in value):
        for k, inner in enumerate(value):
            yield from _entries(inner, f"{name}[{k}]")
    else:
        yield name, value


def _differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, list[Any]]:
    """{key: [value before, value now]} of two dicts, None where there is none."""
    keys = dict.fromkeys([*before, *now])
    return {key: [before.get(key), now.get(key)] for key in keys if before.get(key) != now.get(key)}


def _check_scene(path: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    changed = _differences(before.get("scene", {}), now["scene"])
    if not changed:
        return
    said = [f"{key} holds something else" if key.endswith(".file") else f"{key} {shown(pair)}"
            for key, pair in changed.items()]
    raise RestartError(f"{path}: is of another scene: {', '.join(said)}; a restart goes on in the scene that it began "
                       "with: run the case anew, with --out into another folder")


def resume(path: Path, saved: Saved, record: dict[str, Any], time: Time) -> dict[str, Any]:
    """The record of a run that goes on from a restart file, with its changes behind those of earlier restarts.

    record: of the case as it is now; time: its block. Raises RestartError where the case ends before what was reached.
    """
    state = saved.state
    for key, end, reached in (("end", time.end, state.time), ("max_steps", time.max_steps, state.step)):
        if end is not None and reached > end * (1.0 + 1e-12):
            raise RestartError(f"{path}: the run has come to step {state.step}, time {state.time:g}, and the case ends "
                               f"before that: time.{key} is {end:g}; give a later end, --set time.{key}=..., or run "
                               "the case anew, with --out into another folder")
    changes = _differences(saved.record["values"], record["values"])
    entry = [{"step": state.step, "time": state.time, "changes": changes}] if changes else []
    return record | {"changes": saved.record["changes"] + entry}


def sentences(record: Mapping[str, Any], of_flow: bool = False) -> list[str]:
    """A line for every restart that changed a value: 'step 41, time 0.1: fluids.water.viscosity 0.1 -> 0.2'.

    of_flow: only of values of the flow itself, not of how long and how exactly it is computed.
    """
    lines = []
    for entry in record["changes"]:
        what = [f"{key} {shown(pair)}" for key, pair in entry["changes"].items()
                if not (of_flow and key.startswith(("time.", "solver.")))]
        if what:
            lines.append(" ".join(f"step {entry['step']}, time {entry['time']:.6g}: {', '.join(what)}".split()))
    return lines


def shown(pair: Sequence[Any]) -> str:
    """'0.1 -> 0.2' of [value before, value now]; 'none' where there is none."""
    return " -> ".join("none" if value is None else json.dumps(value, ensure_ascii=False) for value in pair)
