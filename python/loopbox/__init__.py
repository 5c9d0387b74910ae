"""Several cameras, one map: semi-direct monocular SLAM with merging of maps.

`run` maps a recording, `merge` brings maps together, `evaluate` compares with ground truth; `Agent` takes frames one by
one, `Map` shows what came of it as NumPy arrays. Cameras have x right, y down, z forward; matrices are world_from_camera;
lengths are in map units, which are metres where `Map.metric` says so.
"""

from __future__ import annotations

import html
import json
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from . import _loopbox
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
    "__version__",
    "evaluate",
    "merge",
    "run",
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
        report = self.folder / "report.html"
        if not report.is_file():
            return None
        page = html.escape(report.read_text(encoding="utf-8"), quote=True)
        # The page needs its scripts and nothing of the notebook's.
        style = "width: 100%; height: 640px; border: 0"
        return f'<iframe srcdoc="{page}" sandbox="allow-scripts" style="{style}"></iframe>'


@dataclass(frozen=True)
class RunResult(_Results):
    """What came of a run."""

    @property
    def tracked(self) -> int:
        """Frames with a pose."""
        return self.record["frames"]["tracked"]


@dataclass(frozen=True)
class MergeResult(_Results):
    """What came of a merge."""

    met: bool
    """Whether any two maps met; if not, nothing was written."""
    verdict: str = field(repr=False)
    """For each pair what was decided and by what evidence, for people."""


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

    `recording` is a folder of images, an MCAP file or a ROS 1 bag; `calibration` a camera.yaml, where none came with it and
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


def merge(maps: Iterable[StrPath], out: StrPath, *, force: bool = False) -> MergeResult:
    """Merges maps, each a map.mcap or the folder of a run, and writes the common map into the folder `out`."""
    met, verdict, record = _loopbox.merge(list(maps), out, force=force)
    return MergeResult(Path(out), json.loads(record), met, verdict)


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
