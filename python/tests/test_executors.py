"""Many recordings and pairs, on the workers of an executor."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import loopbox
import pytest


def content(folder, pattern="*"):
    return {path.name: path.read_bytes() for path in folder.glob(pattern)}


def test_verdicts_of_a_pool_of_processes_give_the_same_map(runs, tmp_path):
    folders = [run.folder for run in runs.values()]
    alone = loopbox.merge(folders, tmp_path / "alone")
    # The module was used in this process before: what is forked from it must not wait for its threads.
    with ProcessPoolExecutor(2) as pool:
        shared = loopbox.merge(folders, tmp_path / "shared", executor=pool)
    assert (tmp_path / "shared/map.mcap").read_bytes() == (tmp_path / "alone/map.mcap").read_bytes()
    assert shared.met and shared.verdict == alone.verdict
    kept = content(tmp_path / "shared/verdicts")
    assert len(kept) == 1 and content(tmp_path / "alone/verdicts") == kept
    found = loopbox.verdict(folders[1], folders[0], verdicts=tmp_path / "again")
    assert found.joined and "accepted" in found.text and found.encounters[0]["accepted"]
    assert content(tmp_path / "again") == kept
    # A task that is asked again reads nothing: who reads what is kept says that it is none.
    verdict = next((tmp_path / "again").iterdir())
    verdict.write_bytes(b"none")
    loopbox._judge(*folders, str(tmp_path / "again"))
    with pytest.raises(loopbox.LoopboxError, match=verdict.name):
        loopbox.verdict(*folders, verdicts=tmp_path / "again")
    assert [pair[:2] for pair in loopbox.propose(folders)] == [tuple(folders)]


def test_recordings_become_one_map_and_nothing_is_done_twice(demo, runs, tmp_path):
    recordings = [demo / name for name in runs]
    with ProcessPoolExecutor(2) as pool:
        both = loopbox.reconstruct(recordings, tmp_path, executor=pool)
    assert both.met and sorted(both.map().agents) == sorted(runs)
    for name, run in runs.items():
        assert (tmp_path / "maps" / name / "map.mcap").read_bytes() == (run.folder / "map.mcap").read_bytes()
    before = content(tmp_path / "maps/parking_a") | content(tmp_path / "verdicts")
    again = loopbox.reconstruct(recordings, tmp_path)
    assert again.verdict == both.verdict
    # A run or a verdict that is made anew has other times in it, or another name.
    assert content(tmp_path / "maps/parking_a") | content(tmp_path / "verdicts") == before


def test_a_recording_that_cannot_be_mapped_keeps_no_other_from_being_merged(demo, runs, tmp_path):
    still = tmp_path / "still"
    (still / "images").mkdir(parents=True)
    first = sorted((demo / "parking_a/images").iterdir())[0]
    for number in range(12):
        (still / f"images/{number:06}{first.suffix}").symlink_to(first.resolve())
    (still / "times.txt").write_text("".join(f"{n / 15} images/{n:06}{first.suffix}\n" for n in range(12)))
    (still / "camera.yaml").symlink_to((demo / "parking_a/camera.yaml").resolve())
    recordings = [demo / name for name in runs]
    # What the run had is saved, and is not made again.
    whys = ["no frame could be tracked: the images are all alike", "its map has no depth"]
    for executor, why in zip((None, ThreadPoolExecutor(2)), whys):
        with pytest.warns(UserWarning, match=f"left out: .*still: {why}"):
            both = loopbox.reconstruct([*recordings, still], tmp_path / "out", executor=executor)
        assert both.met and sorted(both.map().agents) == sorted(runs)


def test_what_a_worker_could_not_do_is_told_after_the_others(demo, tmp_path):
    recordings = [tmp_path / "nothing", demo / "parking_c"]
    with ThreadPoolExecutor(2) as pool, pytest.raises(loopbox.LoopboxError, match="no such file"):
        loopbox.map(recordings, tmp_path / "maps", executor=pool, end=2.0)
    assert (tmp_path / "maps/parking_c/run.json").is_file()
