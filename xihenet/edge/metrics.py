"""Metrics of the service as Prometheus reads them: counters, and histograms of seconds and sizes.

Text format 0.0.4, written here: three kinds of line do not call for a package. Numbers live in one process, and only
the event loop changes them.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping

SECONDS = (0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
SIZES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)

HELP = {
    "xihe_requests_total": "Requests answered, by route and status.",
    "xihe_records_total": "Records of published clients that were read otherwise than they stand there, by quirk.",
    "xihe_refused_total": "Requests refused because something was full, by what.",
    "xihe_unknown_lights_total": "Lights that could not be known, by reason.",
    "xihe_sessions_total": "Sessions by what happened to them.",
    "xihe_stage_seconds": "Time per request and stage; inference is that of its batch.",
    "xihe_batch_size": "Clouds in one inference.",
    "xihe_sessions": "Sessions open now.",
    "xihe_positions": "Positions known now, of all sessions.",
    "xihe_queue": "Requests that wait for inference now.",
    "xihe_store_up": "Whether the store of sessions answers.",
    "xihe_store_unreadable": "Records in the store that could not be read.",
    "xihe_connections": "Connections open now.",
}

Labels = tuple[tuple[str, str], ...]


class _Histogram:
    def __init__(self, bounds: tuple[float, ...]) -> None:
        self.bounds, self.counts, self.total = bounds, [0] * (len(bounds) + 1), 0.0

    def add(self, value: float) -> None:
        self.counts[bisect_left(self.bounds, value)] += 1
        self.total += value


class Metrics:
    """What has been counted and measured since the start, each line with the number of the `worker`, if it has one."""

    def __init__(self, worker: int | None = None) -> None:
        self._worker: Labels = () if worker is None else (("worker", str(worker)),)
        self._counters: dict[tuple[str, Labels], int] = defaultdict(int)
        self._histograms: dict[tuple[str, Labels], _Histogram] = {}

    def count(self, name: str, n: int = 1, **labels: str) -> None:
        """Add `n` to a counter."""
        self._counters[name, tuple(labels.items())] += n

    def counter(self, name: str, **labels: str) -> int:
        """Its value now."""
        return self._counters.get((name, tuple(labels.items())), 0)

    def measure(self, name: str, value: float, **labels: str) -> None:
        """Add a value to a histogram: of seconds if its name says so, else of sizes."""
        key = name, tuple(labels.items())
        if key not in self._histograms:
            self._histograms[key] = _Histogram(SECONDS if name.endswith("_seconds") else SIZES)
        self._histograms[key].add(value)

    def total(self, name: str, **labels: str) -> float:
        """The sum of what a histogram was given."""
        histogram = self._histograms.get((name, tuple(labels.items())))
        return 0.0 if histogram is None else histogram.total

    def text(self, gauges: Mapping[str, float]) -> str:
        """All of them, and `gauges`, which the caller reads off what it counts."""
        lines: list[str] = []
        names = [*dict.fromkeys(name for name, _ in [*self._counters, *self._histograms]), *gauges]
        for name in names:
            lines.append(f"# HELP {name} {HELP[name]}")
            if name in gauges:
                lines += [f"# TYPE {name} gauge", f"{name}{_labelled(self._worker)} {gauges[name]:g}"]
                continue
            counters = [(labels, n) for (other, labels), n in self._counters.items() if other == name]
            lines.append(f"# TYPE {name} {'counter' if counters else 'histogram'}")
            lines += [f"{name}{_labelled(self._worker + labels)} {n}" for labels, n in counters]
            for (other, labels), histogram in self._histograms.items():
                if other == name:
                    lines += _histogram_lines(name, self._worker + labels, histogram)
        return "\n".join([*lines, ""])


def _labelled(labels: Labels) -> str:
    """Names and values are our own words, so nothing needs escaping."""
    return "{" + ",".join(f'{name}="{value}"' for name, value in labels) + "}" if labels else ""


def _histogram_lines(name: str, labels: Labels, histogram: _Histogram) -> list[str]:
    lines, below = [], 0
    for bound, n in zip([*map("{:g}".format, histogram.bounds), "+Inf"], histogram.counts, strict=True):
        below += n
        lines.append(f"{name}_bucket{_labelled((*labels, ('le', bound)))} {below}")
    return [*lines, f"{name}_sum{_labelled(labels)} {histogram.total:g}", f"{name}_count{_labelled(labels)} {below}"]
