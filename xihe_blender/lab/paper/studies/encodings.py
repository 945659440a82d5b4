"""Encodings: how many bytes is a cloud, and how long does it take to write them?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from xihe_blender.lab.paper.clouds import several_views
from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, Work, measured, measured_ratio, of_rooms
from xihenet.codec import METHODS, EncodingMethod, encode_cloud
from xihenet.edge.bench import times_ms
from xihenet.sphere import AnchorLattice

PAPER: dict[EncodingMethod, tuple[int, int, float]] = {
    "float32": (16, 20480, 0.003),
    "float32_stripped": (18, 10926, 1.793),
    "uint8_float16": (5, 8960, 1.675),
    "uint8_float16_stripped": (7, 4249, 1.003),
}
RECORD = "The same record."
BYTES = (
    "Clouds of one view with 1280 anchors; the paper's are of Matterport3D. The number of anchors that a view sets "
    "decides the bytes."
)
ODD = "1280 anchors of 5 bytes are 6,400 bytes. The paper's 8,960 would be 7 bytes each, probably a slip."
FASTER = "The paper finds stripping faster. Here all records are written in one call, so there is nothing to gain."
TIME = "Ours in NumPy on one core, in one call; theirs in C# on an iPad Pro, in a loop over anchors."


def measure(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    lattice, rng = AnchorLattice(1280), options.rng
    found = several_views(sessions, options)
    clouds = [view.cloud(lattice) for view in found]
    rooms, ms = [view.room for view in found], {}
    for method, (unit, paper_bytes, paper_ms) in PAPER.items():
        record = METHODS[method].bytes_per_record
        yield Row(f"{method}: of an anchor", "bytes", record, record, record, 1, "same work", RECORD, unit, "record")
        sizes = [len(encode_cloud(cloud, method)) for cloud in clouds]
        of_all = measured(sizes, rng, groups=rooms)
        sentence = ODD if method == "uint8_float16" else BYTES
        work: Work = "same work" if method == "float32" else "other data"
        yield Row(f"{method}: mean", "bytes", *of_all, work, sentence, paper_bytes, of_rooms("clouds", rooms))
        ms[method] = [float(np.median(times_ms(partial(encode_cloud, cloud, method), 20))) for cloud in clouds]
        yield Row(f"{method}: mean time", "ms", *measured(ms[method], rng), "other machine", TIME, paper_ms, "clouds")
    ratio = measured_ratio(ms["uint8_float16"], ms["uint8_float16_stripped"], rng)
    yield Row("uint8_float16 over its stripped form, time", "times", *ratio, "other machine", FASTER, 1.67, "clouds")


STUDY = Study(
    "encodings",
    "Encodings",
    90,
    "The paper compares four encodings of a cloud of 1280 anchors; the stripped ones leave out anchors that are not "
    "set.",
    measure,
)
