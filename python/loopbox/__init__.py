"""Several cameras, one map: semi-direct monocular SLAM with merging of maps.

`run` maps a recording, `merge` brings maps together, `evaluate` compares with ground truth; `map`, `verdict` and `reconstruct` do so
for many, on the workers of an executor; `Agent` takes frames one by
one, `Map` shows what came of it as NumPy arrays. Cameras have x right, y down, z forward; matrices are world_from_camera;
lengths are in map units, which are metres where `Map.metric` says so.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from . import _loopbox, _notebook
from ._loopbox import Agent, Cloud, Frame, Keyframe, LoopboxError, Map, __version__

__all__ = [
    "Agent",
    "Cloud",
    "Evaluation",
    "Frame",
    "Keyframe",
    "LoopboxError",
    "Map",
    "MergeResult",
    "RunResult",
    "Verdict",
    "__version__",
    "evaluate",
    "map",
    "merge",
    "propose",
    "reconstruct",
    "run",
    "verdict",
]

StrPath = str | os.PathLike[str]


@dataclass(frozen=True)
class _Results:
    """A folder of results."""

    folder: Path
    """The folder with map.mcap, report.html, cloud.ply and trajectories."""
    record: dict[str, Any] = field(repr=False)
    """All numbers, as in run.json or merge.json (book/src/reference/json.md)."""

    def map(self) -> Map:
        """The map, read from the folder."""
        return Map(self.folder)

    def _repr_html_(self) -> str | None:
        return _notebook.shown(self.folder, self._figures())

    def _figures(self) -> dict[str, object]:
        return {}


@dataclass(frozen=True)
class RunResult(_Results):
    """What came of a run."""

    @property
    def tracked(self) -> int:
        """Frames with a pose."""
        return self.record["frames"]["tracked"]

    def _figures(self) -> dict[str, object]:
        frames, of_map = self.record["frames"], self.record["map"]
        return {
            "frames tracked": f"{self.tracked} of {frames['offered']}",
            "keyframes": of_map["keyframes"],
            "points": of_map["semi_dense"],
            "loops": of_map["loops"],
            "times lost": frames["losses"],
        }


@dataclass(frozen=True)
class MergeResult(_Results):
    """What came of a merge."""

    met: bool
    """Whether any two maps met; if not, only the verdicts were written."""
    verdict: str = field(repr=False)
    """For each pair what was decided and by what evidence, for people."""

    def _figures(self) -> dict[str, object]:
        return {"verdict": self.verdict}


@dataclass(frozen=True)
class Verdict:
    """Whether two maps show one place."""

    joined: bool
    """Whether they are joined where they are merged."""
    text: str = field(repr=False)
    """What was decided and by what evidence, for people."""
    encounters: list[dict[str, Any]] = field(repr=False)
    """The numbers, as among the encounters of merge.json."""


@dataclass(frozen=True)
class Evaluation:
    """How far an estimate is from the truth."""

    measures: dict[str, Any] = field(repr=False)
    """All measures, as `loopbox eval --json` prints them."""

    @property
    def ate_rmse(self) -> float:
        """Root mean square of the absolute trajectory error, in the unit of the truth."""
        return self.measures["ate"]["rmse"]

    @property
    def pairs(self) -> int:
        """Poses compared."""
        return self.measures["pairs"]

    def __repr__(self) -> str:
        return f"<loopbox.Evaluation: ATE {self.ate_rmse:.4f} over {self.pairs} poses>"


def run(
    recording: StrPath,
    out: StrPath,
    *,
    calibration: StrPath | None = None,
    fov: float | None = None,
    name: str | None = None,
    force: bool = False,
    fps: float | None = None,
    topic: str | None = None,
    start: float | None = None,
    end: float | None = None,
    params: Mapping[str, Any] | None = None,
    progress: Callable[[int, float, str], object] | None = None,
) -> RunResult:
    """Tracks and maps a recording, and writes the results into the folder `out`, as `loopbox run` does.

    `recording` is a folder of images, an MCAP file or a ROS 1 bag, or the URI of one in a bucket; `calibration` a camera.yaml, where none came with it and
    none is to be found from the images (`fov`: their horizontal field of view, degrees). `params` has the sections of
    `loopbox params`. `progress` is called with index, time stamp and state of each frame; what it raises, and Ctrl-C, ends
    the run, with what was tracked saved.
    """
    folder, record = _loopbox.run(
        recording,
        out,
        calibration=calibration,
        fov=fov,
        name=name,
        force=force,
        fps=fps,
        topic=topic,
        start=start,
        end=end,
        params=None if params is None else dict(params),
        progress=progress,
    )
    return RunResult(Path(folder), json.loads(record))


def merge(
    maps: Iterable[StrPath],
    out: StrPath,
    *,
    force: bool = False,
    verdicts: StrPath | None = None,
    confirm: Iterable[str] = (),
    executor: Executor | None = None,
) -> MergeResult:
    """Merges maps, each a map.mcap or the folder of a run, and writes the common map into the folder `out`.

    Pairs that have a verdict in `verdicts`, a folder or the URI of a bucket, are not looked at again, and those of others are kept there;
    where none is named, it is the folder `verdicts` in `out`.
    `confirm` names pairs of agents as "A+B" of which you know that both maps show one place, whatever looks otherwise. An
    `executor` (a process pool, Dask's `client.get_executor()`, any `concurrent.futures.Executor`) judges pairs beside each other; its workers
    share the folder of verdicts.
    """
    maps = list(maps)
    if executor is not None:
        verdicts = Path(out) / "verdicts" if verdicts is None else verdicts
        # Where a worker dies or a pair cannot be judged, that is said after all others are kept.
        judged = [executor.submit(_judge, a, b, os.fspath(verdicts)) for a, b, _ in _loopbox.propose(maps)]
        _all(judged)
    met, text, record = _loopbox.merge(maps, out, force=force, verdicts=verdicts, confirm=list(confirm))
    return MergeResult(Path(out), json.loads(record), met, text)


def propose(maps: Iterable[StrPath]) -> list[tuple[StrPath, StrPath, float | None]]:
    """The pairs of maps that may show one place, the likeliest first, with the likeness of their likeliest place (0 to 1); of
    LiDARs every two, with none. Maps are paths, or their URIs as text where they are in a bucket."""
    return [(_place(a), _place(b), score) for a, b, score in _loopbox.propose(list(maps))]


def verdict(
    a: StrPath,
    b: StrPath,
    *,
    verdicts: StrPath | None = None,
    threads: int | None = None,
) -> Verdict:
    """Tells whether two maps show one place. The verdict depends on both maps alone; it is taken from the folder `verdicts` where
    it is there, and kept there otherwise. `threads` is one per core where nothing is said."""
    joined, text, encounters = _loopbox.verdict(a, b, verdicts=verdicts, threads=threads)
    return Verdict(joined, text, json.loads(encounters))


def map(
    recordings: Iterable[StrPath],
    out: StrPath,
    *,
    executor: Executor | None = None,
    **options: Any,
) -> list[RunResult]:
    """Maps recordings, each into a folder of its name in `out`, as `run` does with the same `options`; by the workers of an
    `executor`, which share `out`. A recording whose folder is complete is not mapped again. "s3://BUCKET/PREFIX/*" stands for all that
    lies right under a prefix of a bucket."""
    return [run for _, run in _over(_mapped, recordings, Path(out), executor, options)]


def reconstruct(
    recordings: Iterable[StrPath],
    out: StrPath,
    *,
    executor: Executor | None = None,
    **options: Any,
) -> MergeResult:
    """The whole way from recordings to one map: `map` into `out/maps`, verdicts in `out/verdicts`, the common map in
    `out/merged`. A recording that cannot be mapped, or gives a map without depth, is left out, with a warning. Called again after a kill,
    it does not do again what was done."""
    room = Path(out)
    maps = []
    for recording, done in _over(_mapped_or_why, recordings, room / "maps", executor, options):
        if isinstance(done, LoopboxError):
            warnings.warn(f"left out: {done}", stacklevel=2)
        elif done.record["map"]["semi_dense"]:
            maps.append(done.folder)
        else:
            warnings.warn(f"left out: {recording}: its map has no depth: did the camera move?", stacklevel=2)
    return merge(maps, room / "merged", force=True, verdicts=room / "verdicts", executor=executor)


def _place(name: str) -> StrPath:
    """A path, or the text of a URI, which is none."""
    return name if "://" in name else Path(name)


def _judge(a: StrPath, b: StrPath, verdicts: str) -> None:
    """A worker's task, which may be asked again when the worker that did it is gone."""
    _loopbox.keep_verdict(a, b, verdicts)


def _over(
    task: Callable[[StrPath, Path, dict[str, Any]], Any],
    recordings: Iterable[StrPath],
    out: Path,
    executor: Executor | None,
    options: dict[str, Any],
) -> list[tuple[StrPath, Any]]:
    """Recordings with what a task makes of each in a folder of its name in `out`."""
    folders = _folders(recordings, out)
    if executor is None:
        return [(recording, task(recording, folder, options)) for recording, folder in folders]
    results = _all([executor.submit(task, recording, folder, options) for recording, folder in folders])
    return [(recording, result) for (recording, _), result in zip(folders, results)]


def _mapped_or_why(recording: StrPath, folder: Path, options: dict[str, Any]) -> RunResult | LoopboxError:
    """A worker's task."""
    try:
        return _mapped(recording, folder, options)
    except LoopboxError as error:
        return error


def _mapped(recording: StrPath, folder: Path, options: dict[str, Any]) -> RunResult:
    """A worker's task."""
    numbers = folder / "run.json"
    if not numbers.is_file():
        return run(recording, folder, **options)
    record = json.loads(numbers.read_text(encoding="utf-8"))
    if record["interrupted"]:
        return run(recording, folder, **{**options, "force": True})
    return RunResult(folder, record)


def _folders(recordings: Iterable[StrPath], out: Path) -> list[tuple[StrPath, Path]]:
    """Recordings with a folder for each, called by their names; those of one name get a number."""
    folders: dict[Path, StrPath] = {}
    for recording in _loopbox.recordings(list(recordings)):
        path = Path(recording)
        name = path.name if path.is_dir() else path.stem
        folder, number = out / name, 2
        while folder in folders:
            folder, number = out / f"{name}-{number}", number + 1
        folders[folder] = _place(recording)
    return [(recording, folder) for folder, recording in folders.items()]


def _all(tasks: list[Future[Any]]) -> list[Any]:
    """The results of all tasks; the first error is raised after all have ended."""
    failed = [error for error in [task.exception() for task in tasks] if error is not None]
    if failed:
        raise failed[0]
    return [task.result() for task in tasks]


def evaluate(
    estimate: StrPath,
    truth: StrPath,
    *,
    frames: StrPath | None = None,
    align: Literal["none", "se3", "sim3", "scale"] = "sim3",
    max_diff: float = 0.02,
) -> Evaluation:
    """Compares a trajectory, a file or the folder of a run, with its ground truth.

    `frames` names the times of the recording's frames, which coverage counts; `max_diff` is the largest difference of times
    that belong together, seconds.
    """
    measures = _loopbox.evaluate(estimate, truth, frames=frames, align=align, max_diff=max_diff)
    return Evaluation(json.loads(measures))
