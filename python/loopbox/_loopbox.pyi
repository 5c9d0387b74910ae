import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

StrPath = str | os.PathLike[str]

__version__: str

class LoopboxError(RuntimeError):
    """What loopbox could not do; the text says why, and how to mend it."""

@final
class Agent:
    """Tracks a camera and maps what it sees."""

    def __new__(
        cls,
        calibration: StrPath | dict[str, Any],
        *,
        name: str = "agent",
        params: dict[str, Any] | None = None,
    ) -> Agent: ...
    def process(self, image: NDArray[np.uint8], timestamp: float) -> Frame:
        """Tracks the next frame: rows × columns (grey) or × 3 (red, green, blue); time stamps grow, seconds."""

    def map(self) -> Map:
        """The map as it stands; the agent can go on."""

    def finish(self) -> Map:
        """The map after the last frame: depth and loops of the last keyframes, and the last optimisation of all."""

@final
class Frame:
    """What became of a frame."""

    @property
    def state(self) -> str:
        """"starting", "tracking" or "lost"."""

    @property
    def pose(self) -> NDArray[np.float64] | None:
        """world_from_camera as known now, 4×4."""

    @property
    def covariance(self) -> NDArray[np.float64] | None:
        """Covariance of the pose relative to the keyframes around it, 6×6: of (υ, ω), in the axes of the camera, map units and radians. What
        the map errs from one place to another is not in it; None for frames that begin a map."""

    @property
    def keyframe(self) -> int | None:
        """The keyframe made from it."""

    @property
    def matched_points(self) -> int: ...
    @property
    def reason(self) -> str | None:
        """Why it was not tracked."""

    @property
    def scale_break(self) -> dict[str, int] | None:
        """Where the scale was not carried on, some keyframes ago: the keyframe `before`, how many `points` measure the scale across it, and
        the `inliers` among them. What is mapped since then has a unit of its own; each place is said once."""

@final
class Map:
    """A map of one agent or several; it does not change."""

    def __new__(cls, path: StrPath) -> Map: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Keyframe]: ...
    def __getitem__(self, index: int) -> Keyframe:
        """The keyframe at this place in their order; of a negative one from the end."""

    def keyframe(self, id: int) -> Keyframe:
        """The keyframe with this `id`."""

    @property
    def agents(self) -> list[str]: ...
    @property
    def metric(self) -> bool:
        """Whether a unit is a metre."""

    @property
    def keyframes(self) -> list[Keyframe]: ...
    @property
    def poses(self) -> NDArray[np.float64]:
        """world_from_camera of the keyframes in their order, n×4×4."""

    def trajectory(self, agent: str | None = None) -> NDArray[np.float64]:
        """A row for each frame: timestamp tx ty tz qx qy qz qw."""

    def cloud(self, max_variance: float = 0.01, voxel: float | None = None) -> Cloud:
        """Points whose variance of inverse depth over its square is at most this; of each cube of edge `voxel` the surest."""

    def save(self, path: StrPath) -> None:
        """Writes the map as a map.mcap."""

    def save_ply(self, path: StrPath, max_variance: float = 0.01, voxel: float | None = None) -> int:
        """Writes the cloud; gives the number of points."""

@final
class Keyframe:
    """A keyframe of a map. `image`, `pixels`, `inverse_depths` and `variances` are read-only views of the map's memory."""

    @property
    def id(self) -> int: ...
    @property
    def agent(self) -> str: ...
    @property
    def timestamp(self) -> float: ...
    @property
    def frame_index(self) -> int: ...
    @property
    def pose(self) -> NDArray[np.float64]:
        """world_from_camera, 4×4."""

    @property
    def unit(self) -> float:
        """Map units of one of its own units of depth."""

    @property
    def camera(self) -> NDArray[np.float64] | None:
        """The 3×3 matrix of its undistorted image's camera; pixel centres at integers."""

    @property
    def image(self) -> NDArray[np.uint8]:
        """The undistorted grey image, rows × columns."""

    @property
    def color(self) -> NDArray[np.uint8] | None:
        """The undistorted image in colour, rows × columns × 3 (red, green, blue); None where its source was grey."""

    @property
    def pixels(self) -> NDArray[np.uint32]:
        """Indices row · columns + column of the pixels with depth, ascending."""

    @property
    def inverse_depths(self) -> NDArray[np.float32]:
        """Of those pixels 1/z, in one over its own unit."""

    @property
    def variances(self) -> NDArray[np.float32]:
        """Of the inverse depths."""

    def depth(self) -> NDArray[np.float32]:
        """Depth along the optical axis in map units, rows × columns; NaN where none is known."""

@final
class Cloud:
    """Points of a map, a row each."""

    @property
    def positions(self) -> NDArray[np.float32]:
        """In the world, n×3."""

    @property
    def intensities(self) -> NDArray[np.uint8]: ...
    @property
    def colors(self) -> NDArray[np.uint8]:
        """Red, green and blue, n×3; where the source was grey, three times the intensity."""

    @property
    def confidences(self) -> NDArray[np.float32]:
        """Depth is known to one part in so many."""

    @property
    def agents(self) -> NDArray[np.uint16]:
        """By number in the order of `Map.agents`."""

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
    params: dict[str, Any] | None = None,
    progress: Callable[[int, float, str], object] | None = None,
) -> tuple[str, str]: ...
def merge(
    maps: Sequence[StrPath],
    out: StrPath,
    *,
    force: bool = False,
    verdicts: StrPath | None = None,
    confirm: Sequence[str] = (),
) -> tuple[bool, str, str]: ...
def recordings(names: Sequence[StrPath]) -> list[str]: ...
def propose(maps: Sequence[StrPath]) -> list[tuple[str, str, float | None]]: ...
def verdict(
    a: StrPath,
    b: StrPath,
    *,
    verdicts: StrPath | None = None,
    threads: int | None = None,
) -> tuple[bool, str, str]: ...
def keep_verdict(a: StrPath, b: StrPath, verdicts: StrPath) -> None: ...
def evaluate(
    estimate: StrPath,
    truth: StrPath,
    *,
    frames: StrPath | None = None,
    align: str = "sim3",
    max_diff: float = 0.02,
) -> str: ...
