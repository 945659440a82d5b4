"""Report of a batch: the questions that people come with, answered in words, each with its plot and its numbers; then
worst cases with their pictures, distributions, and what everything cost. One self-contained page.

Made from results.json and the pictures of worst frames alone, never from Blender.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from xihe_blender.io.run_results import ERROR_AT_FULL_SCALE
from xihe_blender.lab.batch import answers, drawings
from xihe_blender.lab.batch.answers import MEASURES, Measure, format_interval
from xihe_blender.lab.batch.results import WORST_KINDS, BatchFolder, BatchResults, Trial, UnitRow, worst_picture
from xihe_blender.lab.frontier.answers import HOW_MANY_ANCHORS, LAST_TENTH
from xihe_blender.lab.frontier.points import family, group
from xihe_blender.lab.frontier.records import Frontier, FrontierPoint
from xihe_blender.lab.frontier.report import LAB_STYLE
from xihe_blender.report.document import block, document, png_url, table
from xihe_blender.report.values import code, escape, mean
from xihenet.camera import DEFAULT_SIZE
from xihenet.formats import (
    MINUS,
    format_bytes,
    format_count,
    format_milliseconds,
    format_number,
    format_percent,
    format_quantity,
    format_runs,
)

N_WORST = 6
_KIND_WORDS = {
    "ground_truth": "Ground truth",
    "estimate": "Under the estimated light",
    "error": f"Error in sRGB (black: none, brightest: {format_percent(ERROR_AT_FULL_SCALE)} or more)",
}
_DOTS = "A dot is a trial: one scene with one seed and one phone. The box holds the middle half of them."

WITHOUT_FRONTIER = (
    f"That takes measured times: run {code('xihe frontier SCENE.blend --out DIR')} and give its folder as "
    f"{code('--frontier DIR')} to the same command, or put its frontier.json into this folder."
)


def report_page(folder: BatchFolder, results: BatchResults, frontier: Frontier | None) -> str:
    trials, lead = results.trials, "No trial could be done."
    failed = "".join(f"<li>{code(one.what)}: {escape(one.reason)}</li>" for one in results.failed)
    warning = f'<div class="block warning"><ul>{failed}</ul></div>'
    sections = [("failed", "What could not be done", warning)] if failed else []
    if trials:
        lead = answers.what_it_stands_on(trials)
        sections += [
            ("estimator", "Which estimator should I ship?", _estimators(trials, results.units)),
            ("phone", "Is a better phone worth it?", _phones(trials)),
            ("often", "How often must it run?", _how_often(trials)),
            *_from_frontier(frontier),
            ("worst", "Worst cases", _worst(folder, trials)),
            ("numbers", "Numbers", _by_scene(trials) + _quantiles(trials) + _costs(results.units)),
            ("made", "How it was made", _how_made(results)),
        ]
    return document("Batch evaluation", f'<p class="lead">{lead}</p>', sections, has_links=False, style=LAB_STYLE)


def _answered(words: str, *plots: str) -> str:
    """An answer with its plots; one that is empty does not count."""
    return f'<p class="answer">{words}</p>' + (f'<div class="plots">{"".join(plots)}</div>' if any(plots) else "")


# ----------------------------------------------------------------------------------------------------- the questions


def _estimators(trials: Sequence[Trial], units: Sequence[UnitRow]) -> str:
    drawn = [_distribution(trials, measure) for measure in MEASURES]
    drawn += [_against_the_best(trials, measure) for measure in MEASURES]
    return _answered(answers.which_estimator(trials), *drawn) + _times_table(trials, units) + _pairs_table(trials)


def _times_table(trials: Sequence[Trial], units: Sequence[UnitRow]) -> str:
    """What each estimator's error costs in time."""
    step_ms, rows = {unit.unit: unit.step_ms for unit in units}, []
    for name in answers.names_of(trials, "estimator"):
        own = [step_ms[trial.unit][trial.number] for trial in answers.chosen(trials, estimator=name)]
        known = [ms for ms in own if ms is not None]
        time = format_quantity(statistics.median(known) if known else None, "ms")
        rows.append((code(name), _mean_error(trials, estimator=name), time))
    about = "A step is the chain from unproject to estimate at one position in a frame; rendering is not in it."
    head = ("estimator", "mean light error", "time of a step, median")
    return f'{table(head, rows, "stacking")}<p class="quiet">{about}</p>'


def _distribution(trials: Sequence[Trial], measure: Measure) -> str:
    rows = []
    for index, name in enumerate(answers.names_of(trials, "estimator")):
        dots = [
            (value, f"{t.scene}, seed {t.seed}, {t.phone}: {format_number(value)}")
            for t in answers.chosen(trials, estimator=name)
            if (value := measure.of(t)) is not None
        ]
        rows.append((name, index, dots))
    better = "Further left is better." if measure.is_better_low else "Further right is better."
    return drawings.strips(rows, title=measure.title, about=f"{_DOTS} {better}", axis_name=measure.unit or "no unit")


def _against_the_best(trials: Sequence[Trial], measure: Measure) -> str:
    rows = _intervals(answers.against_the_best(trials, measure), answers.names_of(trials, "estimator"))
    about = "Paired differences of the same scene, seed and phone, with 95 % intervals of their mean. Right"
    about += " of the dashed line the first has more error." if measure.is_better_low else ": the first is better."
    title = f"{measure.title}: differences"
    return drawings.differences(rows, title=title, about=about, axis_name=measure.unit or "no unit")


def _intervals(found: Sequence[answers.Comparison], names: Sequence[str]) -> list[drawings.Interval]:
    """A row for each, coloured by the place of the first in `names`."""
    return [
        (f"{one.first} {MINUS} {one.second}", names.index(one.first), one.difference, format_interval(one.difference))
        for one in found
    ]


def _pairs_table(trials: Sequence[Trial]) -> str:
    rows = []
    for measure in MEASURES:
        for one in answers.against_the_best(trials, measure):
            d = one.difference
            better = d.share_lower if measure.is_better_low else d.share_higher
            first_is_better = f"{round(better * d.n_pairs)} of {d.n_pairs}"
            pair = f"{code(one.first)} against {code(one.second)}"
            rows.append((pair, escape(measure.title), format_interval(d), first_is_better))
    return table(("pair", "measure", "mean difference", "first is better"), rows, "words stacking")


def _phones(trials: Sequence[Trial]) -> str:
    names, phones = (answers.names_of(trials, key) for key in ("estimator", "phone"))
    rows = _intervals(answers.phone_differences(trials), phones)
    about = "The same scene and seed through two phones, with 95 % intervals of the mean. Left: the first is better."
    title = "Light error: differences between phones"
    plot = drawings.differences(rows, title=title, about=about, axis_name="no unit")
    means = [(code(name), *(_mean_error(trials, estimator=name, phone=phone) for phone in phones)) for name in names]
    head = ("mean light error", *map(escape, phones))
    by_phone = table(head, means, "stacking") if rows else ""
    return _answered(answers.is_a_better_phone_worth_it(trials), plot) + by_phone


def _mean_error(trials: Sequence[Trial], **which: str) -> str:
    return format_number(mean(answers.values_of(trials, MEASURES[0], **which)))


def _how_often(trials: Sequence[Trial]) -> str:
    lines, rows = [], []
    for index, name in enumerate(answers.names_of(trials, "estimator")):
        dots = []
        for p in answers.trigger_points(trials, name):
            error, more = format_number(p.error), "" if p.more is None else format_interval(p.more)
            words = f"{name}, theta {p.theta}: {p.per_minute:.0f} a minute, error {error}"
            dots.append((p.per_minute, p.error, words))
            rows.append([code(name), p.theta, format_number(p.per_minute), error, more])
        lines.append((name, index, dots))
    about = (
        "Mean over trials. Each dot is a trigger: from every frame, right, to 64 times the thresholds, left. The same "
        "captures, nothing rendered again."
    )
    plot = drawings.curves(
        lines, title="Error against how often it runs", about=about,
        x_name="estimates a minute, per position in view", y_name="SHC RMSE",
    )  # fmt: skip
    header = ("estimator", "theta", "a minute", "mean error", "more than with every frame")
    return _answered(answers.how_often(trials), plot) + (table(header, rows, "stacking") if rows else "")


# ------------------------------------------------------------------------------------------ of a frontier


def _from_frontier(frontier: Frontier | None) -> list[tuple[str, str, str]]:
    """Sections on what takes measured times; one for both where there are none."""
    if frontier is None:
        return [("anchors", f"{HOW_MANY_ANCHORS} {LAST_TENTH}", _answered(WITHOUT_FRONTIER))]
    return [
        ("anchors", HOW_MANY_ANCHORS, _answered(_answer(frontier, HOW_MANY_ANCHORS), _by_anchors(frontier))),
        ("last", LAST_TENTH, _answered(_answer(frontier, LAST_TENTH), *_on_fronts(frontier))),
    ]


def _by_anchors(frontier: Frontier) -> str:
    """A plot with a dot for each number in the answer."""
    own: list[FrontierPoint] = []
    for scene in answers.names_of(frontier.points, "scene"):
        own += family(group(frontier.points, scene, "compute", "coefficients_truth"), ("n_anchors",))
    own.sort(key=lambda point: point.computing.n_anchors)
    return _error_against_time(
        [(f"{point.computing.n_anchors} anchors", point) for point in own],
        "Computing: error against time, by anchors",
        "against the rendered light probe, of choices that differ only in their anchors",
        is_joined=False,
    )


def _on_fronts(frontier: Frontier) -> Iterator[str]:
    """A plot of each of the two fronts."""
    for front, doing in (("render", "Rendering"), ("compute", "Computing")):
        on_front = answers.chosen(frontier.points, front=front, kind="coefficients", on_front=True)
        title = f"{doing}: what lies on the front, by scene"
        by_scene = sorted(((p.scene, p) for p in on_front), key=lambda one: one[0])
        yield _error_against_time(by_scene, title, "against the exhaustive setting")


def _answer(frontier: Frontier, question: str) -> str:
    """What `xihe frontier` says to a question, scene by scene."""
    found = [one for one in frontier.answers if one.question == question]
    words = " ".join(f"<b>{escape(one.scene)}</b>: {escape(one.answer)}" for one in found)
    return words or "The frontier that was given has no answer to that."


def _error_against_time(
    points: Sequence[tuple[str, FrontierPoint]], title: str, about: str, *, is_joined: bool = True
) -> str:
    """Points, each with the name of its curve or cloud; `about` ends the sentence on their error."""
    clouds: dict[str, list[tuple[float, float, str]]] = {}
    for name, p in points:
        words = f"{p.scene}, {p.label}: {format_percent(p.error, 3)} in {format_milliseconds(p.time_ms)}"
        clouds.setdefault(name, []).append((p.time_ms, p.error, words))
    return drawings.curves(
        [(name, index, sorted(cloud)) for index, (name, cloud) in enumerate(clouds.items())],
        title=title,
        about=f"From the frontier that was given: error of the coefficients {about}.",
        x_name="ms a frame",
        y_name="error",
        y_label=lambda share: f"{100 * share:.3g} %",
        is_joined=is_joined,
    )


# ------------------------------------------------------------------------------------------------------- worst cases


def _worst(folder: BatchFolder, trials: Sequence[Trial]) -> str:
    cases = "".join(_case(folder, case) for case in answers.worst_cases(trials, N_WORST))
    if not cases:
        return "<p>No picture was compared.</p>"
    about = "The worst frame of an estimator in a scene, by psnr on the objects."
    return f'<p>{about} Estimators that no phone could run are left out.</p><div class="cases">{cases}</div>'


def _case(folder: BatchFolder, case: answers.WorstCase) -> str:
    trial, frame = case
    figures = "".join(
        f"<figure>{_picture(worst_picture(folder.path / 'units' / trial.unit, trial.number, kind))}"
        f"<figcaption><strong>{_KIND_WORDS[kind]}</strong></figcaption></figure>"
        for kind in WORST_KINDS
    )
    where = f"{escape(trial.scene)}, frame {frame.frame}, {code(trial.estimator)}, {escape(trial.phone)}"
    numbers = f"psnr {format_quantity(frame.psnr, 'dB')}, rmse {format_number(frame.rmse)}, seed {trial.seed}"
    return f'<div><h3>{where}</h3><p class="quiet">{numbers}</p><div class="strip">{figures}</div></div>'


def _picture(path: Path) -> str:
    try:
        content = path.read_bytes()
    except OSError:
        return f'<div class="missing">{escape(path.name)} is missing</div>'
    return f'<img alt="" src="{png_url(content)}">'


# ----------------------------------------------------------------------------------------------------------- numbers


def _how_made(results: BatchResults) -> str:
    """What all trials share, by the names of the command's options, and the versions."""
    chosen = results.settings
    size = "x".join(map(str, chosen.size or DEFAULT_SIZE))
    rows = [
        ("--preset", chosen.preset),
        ("--target", chosen.target),
        ("--light", chosen.light),
        ("--size", size if chosen.size is not None else f"{size}, or upright where the scene is"),
        ("--frames", "all of each scene's" if chosen.frames is None else format_runs(chosen.frames)),
        ("--samples", "as many as the preset's noise target needs" if chosen.samples is None else str(chosen.samples)),
        ("--trigger", chosen.trigger),
        ("--network", "none: estimates arrive at once" if chosen.network is None else chosen.network),
        ("--seeds", ", ".join(map(str, answers.names_of(results.trials, "seed")))),
        *((f"version of {name}", version) for name, version in results.software.items()),
    ]
    return table(("setting", "value"), [(code(name), escape(value)) for name, value in rows], "words stacking")


def _by_scene(trials: Sequence[Trial]) -> str:
    names, scenes = (answers.names_of(trials, key) for key in ("estimator", "scene"))
    rows = [(escape(scene), *(_mean_error(trials, estimator=n, scene=scene) for n in names)) for scene in scenes]
    return block("Mean light error by scene", table(("scene", *map(code, names)), rows, "stacking"))


def _quantiles(trials: Sequence[Trial]) -> str:
    """A table of each measure."""
    header, blocks = ("estimator", "frames", "least", "10 %", "median", "90 %", "most"), ""
    for measure in MEASURES:
        rows = []
        for name in answers.names_of(trials, "estimator"):
            frames = [frame for trial in answers.chosen(trials, estimator=name) for frame in trial.frames]
            if values := [value for frame in frames if (value := measure.of(frame)) is not None]:
                quantiles = map(format_number, np.percentile(values, [0, 10, 50, 90, 100]).tolist())
                rows.append((code(name), str(len(values)), *quantiles))
        blocks += block(f"{measure.title}, over all frames", table(header, rows, "stacking"))
    return blocks


def _costs(units: Sequence[UnitRow]) -> str:
    rows = [
        (
            f"{escape(unit.scene)}, seed {unit.seed}",
            *(format_quantity(seconds, "s") for seconds in (unit.elapsed_s, unit.processor_s, unit.render_s)),
            format_quantity(unit.peak_memory_mb, "MB"),
            format_bytes(unit.written_bytes),
        )
        for unit in units
    ]
    about = "one scene with one seed each, all estimators and phones on the same renders."
    if any(unit.render_s > unit.elapsed_s for unit in units):
        about += " Units that were stopped and resumed have rendered longer than their last process took."
    header = ("unit", "elapsed", "processor", "rendering", "memory at most", "written")
    costs = table(header, rows, "stacking")
    return block("What it cost", f'<p class="quiet">{format_count(len(units), "unit")}: {about}</p>{costs}')
