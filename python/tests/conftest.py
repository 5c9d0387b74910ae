"""The recordings that come with loopbox, run once."""

from pathlib import Path

import loopbox
import pytest

DEMO = Path(__file__).parents[2] / "demo"


@pytest.fixture(scope="session")
def demo() -> Path:
    return DEMO


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, loopbox.RunResult]:
    room = tmp_path_factory.mktemp("runs")
    return {name: loopbox.run(DEMO / name, room / name) for name in ("parking_a", "parking_c")}
