"""What do several frontiers say: are presets where they should be, and which choices flicker between runs?

    python addon_tests/bench/frontier.py DIR...        folders of `xihe frontier`

Prints the presets of every scene, and for scenes that were measured more than once the choices that are on the front in
some of the runs only.
"""

import json

from given import given

from xihe_blender.io.json_records import from_json
from xihe_blender.lab.frontier.points import group, groups
from xihe_blender.lab.frontier.records import Frontier

KINDS = ("coefficients", "irradiance", "picture")
PRESETS = ("draft", "balanced", "accurate")


def presets_table(points):
    """A line per scene, front and kind of error: error and time of each preset, and accurate over draft."""
    print("| scene | front | error in | draft | balanced | accurate | accurate / draft | on the front |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for scene, front, kind in groups(points):
        own = {p.preset: p for p in group(points, scene, front, kind) if p.preset}
        if kind not in KINDS or set(own) != set(PRESETS):
            continue
        cells = [f"{own[name].error:.2%} in {own[name].time_ms / 1000:.2f} s" for name in PRESETS]
        ratio = own["accurate"].error / own["draft"].error
        on_front = ", ".join(name for name in PRESETS if own[name].on_front) or "none"
        errors, times = ([getattr(own[name], key) for name in PRESETS] for key in ("error", "time_ms"))
        is_between = errors[0] > errors[1] > errors[2] and times[0] < times[1] < times[2]
        wrong = ", ".join(
            [*(["more than half"] if ratio > 0.5 else []), *([] if is_between else ["balanced not between"])]
        )
        shown = f"{ratio:.2f}{f' ({wrong})' if wrong else ''}"
        print(f"| {scene} | {front} | {kind} | {' | '.join(cells)} | {shown} | {on_front} |")


def flickering_table(runs):
    """Choices on the fronts of all runs, of some, by group."""
    for each in sorted({one for points in runs for one in groups(points)}):
        fronts = [{p.label for p in group(points, *each) if p.on_front} for points in runs if each in groups(points)]
        if len(fronts) < 2:
            continue
        steady = set.intersection(*fronts)
        print(f"{' '.join(each)}: {len(fronts)} runs, {len(steady)} choices on the front in all of them")
        for label in sorted(set.union(*fronts) - steady):
            print(f"    flickers ({sum(label in front for front in fronts)} of {len(fronts)}): {label}")


def main():
    texts = [(folder / "frontier.json").read_text(encoding="utf-8") for folder in given(__doc__, "folders+").folders]
    runs = [from_json(Frontier, json.loads(text)).points for text in texts]
    for points in runs:
        presets_table(points)
    flickering_table(runs)


if __name__ == "__main__":
    main()
