"""A result as a cell of a notebook shows it: a small picture, figures and a link, so that the notebook stays small."""

from __future__ import annotations

import base64
import html
import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SIZE = (480, 320)
"""Columns and rows of the picture."""
POINTS = 200_000
"""Points drawn at most."""
OUTLIERS = 1.0
"""Per cent of the points beyond either end of what is shown."""
BACKGROUND = (24, 28, 34)
TYPES = {"float": "<f4", "double": "<f8", "uchar": "u1", "ushort": "<u2", "uint": "<u4", "int": "<i4"}


def shown(folder: Path, figures: Mapping[str, object]) -> str | None:
    """HTML of a folder of results; `None` where it has no report."""
    report = folder / "report.html"
    if not report.is_file():
        return None
    cloud = folder / "cloud.ply"
    picture = _tag(drawn(*_points(cloud))) if cloud.is_file() else ""
    cell = '<tr><th style="text-align: left">{}</th><td style="text-align: left">{}</td></tr>'
    rows = "".join(cell.format(html.escape(name), html.escape(str(value))) for name, value in figures.items())
    try:
        # Notebooks follow links relative to where they are.
        place = Path(os.path.relpath(report)).as_posix()
    except ValueError:
        place = report.as_posix()
    link = f'<a href="{html.escape(place, quote=True)}" target="_blank">{html.escape(place)}</a>'
    return f'<div>{picture}<table>{rows}</table><p>Report: {link}</p></div>'


def drawn(positions: NDArray[np.float64], colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Points seen along the direction in which they extend least, rows × columns × 3."""
    columns, rows = SIZE
    picture = np.full((rows, columns, 3), BACKGROUND, np.uint8)
    if len(positions) < 3:
        return picture
    centred = positions - np.median(positions, 0)
    # The middle of the points says how they lie, not the few that are far off.
    near = np.linalg.norm(centred, axis=1)
    _, axes = np.linalg.eigh(np.cov(centred[near <= np.quantile(near, 0.9)].T))
    places = centred @ axes[:, [2, 1]]
    low, high = np.percentile(places, [OUTLIERS, 100 - OUTLIERS], axis=0)
    size = np.array(SIZE)
    scale = 0.94 * np.min(size / np.maximum(high - low, 1e-12))
    pixels = ((places - (low + high) / 2) * scale + size / 2).astype(np.int64)
    inside = ((pixels >= 0) & (pixels < size)).all(1)
    picture[pixels[inside, 1], pixels[inside, 0]] = colours[inside]
    return picture


def _points(path: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Positions and colours of an even sample of a binary PLY file."""
    with path.open("rb") as file:
        fields, count = [], 0
        while (line := file.readline()) not in (b"end_header\n", b""):
            words = line.decode("ascii", "replace").split()
            if words[:2] == ["element", "vertex"]:
                count = int(words[2])
            elif words[:1] == ["property"]:
                fields.append((words[2], TYPES[words[1]]))
        begin = file.tell()
    if count == 0:
        return np.empty((0, 3)), np.empty((0, 3), np.uint8)
    every = np.memmap(path, np.dtype(fields), "r", begin, (count,))
    some = every[:: -(-count // POINTS)]
    colours = np.stack([some[name] for name in ("red", "green", "blue")], 1)
    return np.stack([some[name] for name in "xyz"], 1).astype(float), colours


def _tag(picture: NDArray[np.uint8]) -> str:
    data = base64.b64encode(_png(picture)).decode("ascii")
    return f'<img alt="The points of the map" width="{SIZE[0]}" src="data:image/png;base64,{data}">'


def _png(picture: NDArray[np.uint8]) -> bytes:
    """The picture as PNG."""
    rows, columns, _ = picture.shape

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    # Each row begins with the number of its filter, 0 for none.
    lines = np.concatenate([np.zeros((rows, 1), np.uint8), picture.reshape(rows, -1)], 1)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(lines.tobytes(), 9)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body
