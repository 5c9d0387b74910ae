"""Frames pushed one by one."""

import itertools
import time
import warnings
from pathlib import Path

import loopbox
import numpy as np
import pytest
from PIL import Image


def frames(folder: Path):
    for line in (folder / "times.txt").read_text().splitlines():
        if not line.startswith("#"):
            timestamp, name = line.split()
            yield float(timestamp), np.asarray(Image.open(folder / name))


@pytest.fixture
def lossless(demo, tmp_path) -> Path:
    """A recording that all decoders read alike: JPEGs come out a little different of each."""
    folder = tmp_path / "recording"
    (folder / "images").mkdir(parents=True)
    (folder / "camera.yaml").write_bytes((demo / "parking_a/camera.yaml").read_bytes())
    times = []
    for number, (timestamp, image) in enumerate(frames(demo / "parking_a")):
        Image.fromarray(image).save(folder / f"images/{number:06}.png", compress_level=1)
        times.append(f"{timestamp!r} images/{number:06}.png\n")
    (folder / "times.txt").write_text("".join(times))
    return folder


def test_frames_pushed_make_the_map_of_a_run(runs, lossless, tmp_path):
    run = loopbox.run(lossless, tmp_path / "run")
    agent = loopbox.Agent(lossless / "camera.yaml", name="pushed")
    poses, seconds, certain = {}, 0.0, 0
    for timestamp, image in frames(lossless):
        start = time.perf_counter()
        frame = agent.process(image, timestamp)
        seconds += time.perf_counter() - start
        if frame.pose is not None:
            assert frame.state == "tracking" and frame.reason is None and frame.matched_points > 0
            poses[timestamp] = frame.pose
            if frame.covariance is not None:
                assert frame.covariance.shape == (6, 6) and np.all(np.linalg.eigvalsh(frame.covariance) > 0)
                certain += 1
    assert len(agent.map()) > 2
    made = agent.finish()
    assert made.agents == ["pushed"]
    assert np.array_equal(made.poses, run.map().poses), "as by the program"
    assert len(poses) >= 0.9 * run.tracked and certain >= 0.9 * len(poses)
    made.save(tmp_path / "map.mcap")
    merged = loopbox.merge([tmp_path / "map.mcap", runs["parking_c"].folder], tmp_path / "both")
    assert merged.met
    record = run.record
    print(f"{1e3 * seconds / record['frames']['processed']:.1f} ms a frame pushed, {record['cost']['mean_ms']:.1f} ms in a run")


def test_images_are_grey_or_colour():
    fields = {"model": "pinhole", "width": 64, "height": 48, "fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "distortion": []}
    agent = loopbox.Agent(fields)
    noise = np.random.default_rng(1).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    assert agent.process(noise, 0.0).pose is None
    assert agent.process(noise[:, :, 0], 0.1).state == "starting", "not contiguous"
    assert agent.process(np.ascontiguousarray(noise[:, :, 0]), 0.2).state == "starting"
    with pytest.raises(loopbox.LoopboxError, match="64×48"):
        agent.process(noise[:20], 0.3)
    with pytest.raises(ValueError, match="shape"):
        agent.process(np.zeros(9, dtype=np.uint8), 0.3)
    with pytest.raises(TypeError):
        agent.process(np.zeros((48, 64), dtype=np.float64), 0.3)
    for timestamp in (0.2, 0.1, float("nan")):
        with pytest.raises(loopbox.LoopboxError, match="does not follow"):
            agent.process(noise, timestamp)


def test_calibrations_are_files_or_fields(tmp_path):
    with pytest.raises(loopbox.LoopboxError, match="nothing.yaml"):
        loopbox.Agent(tmp_path / "nothing.yaml")
    with pytest.raises(loopbox.LoopboxError, match="fx"):
        loopbox.Agent({"model": "pinhole", "width": 64, "height": 48})
    with pytest.raises(TypeError, match="camera.yaml"):
        loopbox.Agent(5)


def test_what_is_odd_is_warned_of(demo, tmp_path):
    """A view of 170 degrees that lenses without a fisheye model do not have."""
    calibration = tmp_path / "camera.yaml"
    lines = (demo / "parking_c/camera.yaml").read_text().splitlines()
    odd = ["fx: 20" if line.startswith("fx") else "fy: 20" if line.startswith("fy") else line for line in lines]
    calibration.write_text("\n".join(odd))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            loopbox.run(demo / "parking_c", tmp_path / "out", calibration=calibration, end=0.5)
        except loopbox.LoopboxError:
            pass
    assert any("view is" in str(warning.message) for warning in caught)


def test_frames_in_colour_make_a_map_in_colour(demo):
    def pushed(paint):
        agent = loopbox.Agent(demo / "parking_a/camera.yaml")
        for timestamp, image in itertools.islice(frames(demo / "parking_a"), 25):
            agent.process(paint(image), timestamp)
        return agent.finish()

    red = pushed(lambda image: np.stack([image, image // 2, image // 2], axis=-1))
    keyframe, colors = red[0], red.cloud().colors.astype(float)
    assert keyframe.color.shape == (*keyframe.image.shape, 3) and keyframe.color.dtype == np.uint8
    assert len(colors) == len(red.cloud().positions)
    # Frames as dark as these are brightened, which leaves the differences between their colours.
    first = next(iter(frames(demo / "parking_a")))[1].astype(int)
    redder = keyframe.color[..., 0].astype(int) - keyframe.color[..., 1]
    assert np.median(np.abs(redder - (first - first // 2))) <= 3
    assert np.median(colors[:, 0]) > 1.3 * np.median(colors[:, 1])
    grey = pushed(lambda image: image)
    assert grey[0].color is None
    assert np.array_equal(grey.cloud().colors[:, 0], grey.cloud().intensities)
