"""Running, merging and evaluating recordings in files."""

import threading
import time

import loopbox
import numpy as np
import pytest


def test_a_recording_is_run_and_evaluated(runs, demo):
    result = runs["parking_a"]
    count = len((demo / "parking_a/times.txt").read_text().splitlines())
    assert result.tracked >= 0.95 * (count - 1)
    truth = demo / "parking_a/groundtruth.txt"
    measured = loopbox.evaluate(result.folder, truth)
    assert measured.ate_rmse < 0.05 and measured.pairs == result.tracked
    with pytest.raises(loopbox.LoopboxError):
        loopbox.evaluate(result.folder / "nothing.txt", truth)
    with pytest.raises(ValueError, match="sim3"):
        loopbox.evaluate(result.folder, truth, align="any")


def test_maps_are_arrays(runs):
    shown = runs["parking_a"].map()
    assert shown.agents == ["parking_a"] and not shown.metric
    assert shown.poses.shape == (len(shown), 4, 4)
    assert np.allclose(shown.poses[:, 3], [0, 0, 0, 1])
    assert np.allclose(np.linalg.det(shown.poses[:, :3, :3]), 1)
    assert shown.trajectory().shape == (runs["parking_a"].tracked, 8)
    assert np.array_equal(shown.trajectory("parking_a"), shown.trajectory())
    file = np.loadtxt(runs["parking_a"].folder / "trajectory.txt")
    assert np.allclose(shown.trajectory(), file, atol=1e-6)
    cloud = shown.cloud()
    points = len(cloud.positions)
    assert cloud.positions.shape == (points, 3) and points > 10_000
    assert len(cloud.intensities) == len(cloud.confidences) == len(cloud.agents) == points
    assert np.isfinite(cloud.positions).all() and cloud.confidences.min() >= 10 * (1 - 1e-6)
    assert len(shown.cloud(voxel=0.1).positions) < points / 2
    with pytest.raises(KeyError):
        shown.trajectory("nobody")
    assert [k.id for k in shown] == [k.id for k in shown.keyframes] and len(list(shown)) == len(shown)
    assert shown[-1].id == list(shown)[-1].id and shown[0].id == shown.keyframe(shown[0].id).id
    for wrong in (9999, -9999):
        with pytest.raises(IndexError):
            shown[wrong]
    with pytest.raises(KeyError):
        shown.keyframe(9999)


def test_help_tells_what_there_is():
    assert loopbox.Map.__module__ == "loopbox" and loopbox.Agent.__module__ == "loopbox"
    for method in (loopbox.Agent.process, loopbox.Map.trajectory, loopbox.Map.cloud, loopbox.Keyframe.depth):
        assert method.__doc__ and method.__doc__[0].isupper(), method


def test_keyframes_are_views_of_the_map(runs):
    keyframe = runs["parking_a"].map().keyframes[2]
    image = keyframe.image
    camera = keyframe.camera
    assert image.dtype == np.uint8 and camera[0, 0] > 100
    assert not image.flags.writeable and not image.flags.owndata
    with pytest.raises(ValueError):
        image[0, 0] = 1
    depth = keyframe.depth()
    known = np.flatnonzero(np.isfinite(depth))
    assert np.array_equal(known, keyframe.pixels) and len(known) > 100
    assert np.allclose(depth.ravel()[known], keyframe.unit / keyframe.inverse_depths)
    assert keyframe.variances.shape == keyframe.pixels.shape
    before = image.copy()
    del keyframe, depth, known
    assert np.array_equal(image, before), "the view keeps the map"


def test_depth_is_that_of_the_cloud(runs):
    shown = runs["parking_a"].map()
    keyframe = shown.keyframes[1]
    depth, camera = keyframe.depth(), keyframe.camera
    v, u = np.unravel_index(keyframe.pixels[:50], depth.shape)
    z = depth[v, u]
    x = (u - camera[0, 2]) / camera[0, 0] * z
    y = (v - camera[1, 2]) / camera[1, 1] * z
    world = np.stack([x, y, z], 1) @ keyframe.pose[:3, :3].T + keyframe.pose[:3, 3]
    cloud = shown.cloud(max_variance=1e9).positions
    nearest = np.abs(cloud[:, None] - world[None]).sum(2).min(0)
    assert nearest.max() < 1e-3


def test_maps_are_merged(runs, tmp_path):
    folders = [run.folder for run in runs.values()]
    merged = loopbox.merge(folders, tmp_path / "both")
    assert merged.met and merged.verdict
    both = merged.map()
    assert sorted(both.agents) == ["parking_a", "parking_c"]
    assert set(both.cloud().agents) == {0, 1}
    for result in (merged, runs["parking_a"]):
        shown = result._repr_html_()
        assert "data:image/png" in shown and str(result.folder.name + "/report.html") in shown
        assert len(shown) < 250_000, "a notebook stays small"
    assert "frames tracked" in runs["parking_a"]._repr_html_()
    with pytest.raises(loopbox.LoopboxError, match="one map"):
        loopbox.merge(folders[:1], tmp_path / "none")
    with pytest.raises(loopbox.LoopboxError, match="they are called parking_a, parking_c"):
        loopbox.merge(folders, tmp_path / "none", confirm=["parking_a+nobody"])
    assert loopbox.merge(folders, tmp_path / "again", confirm=["parking_a+parking_c"]).met


def test_a_map_is_saved_and_read_again(runs, tmp_path):
    shown = runs["parking_a"].map()
    shown.save(tmp_path / "again.mcap")
    again = loopbox.Map(tmp_path / "again.mcap")
    assert np.array_equal(again.poses, shown.poses)
    assert np.array_equal(again.cloud().positions, shown.cloud().positions)
    assert shown.save_ply(tmp_path / "cloud.ply") == len(shown.cloud().positions)


def test_errors_say_what_is_wrong(tmp_path):
    with pytest.raises(loopbox.LoopboxError, match="no such file"):
        loopbox.run(tmp_path / "nothing", tmp_path / "out")
    with pytest.raises(loopbox.LoopboxError, match="there is no map"):
        loopbox.Map(tmp_path)
    with pytest.raises(loopbox.LoopboxError, match="unknown field"):
        loopbox.run(tmp_path, tmp_path / "out", params={"trackin": {}})


def test_progress_is_told_and_can_end_a_run(demo, tmp_path):
    told = []

    def progress(index, timestamp, state):
        told.append((index, state))
        if len(told) == 40:
            raise KeyError("enough")

    with pytest.raises(KeyError, match="enough"):
        loopbox.run(demo / "parking_c", tmp_path / "out", progress=progress)
    assert [index for index, _ in told] == list(range(40)) and told[-1][1] == "tracking"
    assert len(loopbox.Map(tmp_path / "out")) > 1, "what was tracked is saved"


def test_other_threads_run_meanwhile(demo, tmp_path):
    ticks, done = 0, threading.Event()

    def tick():
        nonlocal ticks
        while not done.is_set():
            ticks += 1
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    start = time.monotonic()
    loopbox.run(demo / "parking_c", tmp_path / "out", end=1.0)
    seconds = time.monotonic() - start
    done.set()
    thread.join()
    assert ticks > 20 * seconds
