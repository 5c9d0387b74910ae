"""The example runs as it stands."""

import json
from pathlib import Path

EXAMPLE = Path(__file__).parents[1] / "examples/two_agents.ipynb"


def test_the_example_runs(demo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo").symlink_to(demo)
    cells = json.loads(EXAMPLE.read_text())["cells"]
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), str(EXAMPLE), "exec"), names)
    assert names["both"].met
    assert names["error"] < 0.05
