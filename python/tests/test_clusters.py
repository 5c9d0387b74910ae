"""Dask and Ray, each with two workers on this machine. `LOOPBOX_CLUSTERS=1 script/python` installs them."""

import os
from pathlib import Path

import loopbox
import pytest


def content(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.verdict")}


@pytest.fixture(scope="module")
def alone(runs, tmp_path_factory):
    room = tmp_path_factory.mktemp("alone")
    folders = [run.folder for run in runs.values()]
    return folders, room, loopbox.merge(folders, room / "merged", verdicts=room / "verdicts")


def same(alone, merged, verdicts):
    _, room, result = alone
    assert merged.met and merged.verdict == result.verdict
    assert content(verdicts) == content(room / "verdicts") != {}
    assert (merged.folder / "map.mcap").read_bytes() == (room / "merged/map.mcap").read_bytes()


def test_workers_of_dask_find_the_same_verdicts_and_map(alone, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.Client(n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        executor = client.get_executor()
        merged = loopbox.merge(alone[0], tmp_path / "merged", verdicts=tmp_path / "verdicts", executor=executor)
    same(alone, merged, tmp_path / "verdicts")


def test_tasks_of_ray_find_the_same_verdicts_and_map(alone, tmp_path):
    # A machine that is busy with other tests takes longer than Ray waits by default.
    os.environ["RAY_raylet_start_wait_time_s"] = "180"
    ray = pytest.importorskip("ray")

    @ray.remote
    def judge(a: Path, b: Path, verdicts: Path) -> bool:
        return loopbox.verdict(a, b, verdicts=verdicts, threads=1).joined

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        pairs = loopbox.propose(alone[0])
        assert ray.get([judge.remote(a, b, tmp_path / "verdicts") for a, b, _ in pairs]) == [True]
    finally:
        ray.shutdown()
    same(alone, loopbox.merge(alone[0], tmp_path / "merged", verdicts=tmp_path / "verdicts"), tmp_path / "verdicts")
