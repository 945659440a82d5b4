"""docs/cli.md: every sub-command and option of `xihe`, made from the parsers themselves.

    python -m xihe_blender.cli.document > docs/cli.md

Made from the parsers' actions and not from their help texts, which look different in every version of Python. The part
on `xihe train`, the last, needs torch; without it that part is left out, which a line on stderr and a test say.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator

from xihe_blender.cli.main import COMMANDS, command_parser
from xihenet.option_help import default_of

TRAINING = "\n## xihe train\n"
WITHOUT_TRAINING = (
    "torch is not installed, so the last part, on `xihe train`, is left out: put it back as it was, or install torch "
    "(python -m pip install -e '.[train]') and make the page again"
)
HEAD = """# Command line

`python -m xihe_blender.cli.document > docs/cli.md` makes this page from the parsers of the `xihe` command, and a test
fails if they differ. `python -m xihe_blender` is the same command; inside Blender, with the extension, it is
`blender --command xihe`.

| exit code | meaning |
| --- | --- |
| 0 | the job is done |
| 1 | a part of the job could not be done; every such part is named |
| 2 | a mistake that you can fix; one line on stderr says how |
| 130 | stopped by Ctrl-C; run the same command again to resume. `serve`, which ends so, exits with 0 |

Progress and notes are shown on stderr. With `XIHE_VERBOSE=1`, so is what Blender itself prints.
"""


def document() -> str:
    """The page; without its last part, on training, where torch is missing."""
    pages = [HEAD]
    for name, (parser, summary) in sorted(_sub_commands(command_parser()).items()):
        if name != "train":
            pages += sections(parser, summary)
    with contextlib.suppress(ImportError):
        from xihenet.training.__main__ import training_parser

        pages += sections(training_parser(), COMMANDS["train"])
    return "\n".join(pages)


def sections(parser: argparse.ArgumentParser, summary: str) -> Iterator[str]:
    """Markdown of one parser, then of its own sub-commands."""
    yield f"## {parser.prog}\n\n{summary[:1].upper()}{summary[1:]}.\n"
    below = _sub_commands(parser)
    for one in below.values():
        yield from sections(*one)
    if not below:
        positionals = " ".join(_metavar(action) for action in parser._actions if not action.option_strings)
        yield f"    {parser.prog} {positionals} [options]\n".replace("  [", " [")
        yield "| argument | meaning |\n| --- | --- |"
        yield "\n".join(_row(action) for action in parser._actions if action.dest != "help") + "\n"


def _sub_commands(parser: argparse.ArgumentParser) -> dict[str, tuple[argparse.ArgumentParser, str]]:
    """The parser and the summary of each, by name."""
    found = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return {one.dest: (all_of.choices[one.dest], one.help or "") for all_of in found for one in all_of._choices_actions}


def _metavar(action: argparse.Action) -> str:
    """What stands for the value: "DIR", "ldr|hdr"; empty for a switch."""
    if action.nargs == 0:
        return ""
    if action.choices is not None and action.metavar is None:
        return "|".join(map(str, action.choices))
    name = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
    return f"{name} ..." if action.nargs == "+" else name


def _row(action: argparse.Action) -> str:
    words = (action.help or "").replace("<", "&lt;")
    is_required = bool(action.option_strings) and action.required
    parts = [words, default_of(action), "required" if is_required else ""]
    name = f"{', '.join(action.option_strings)} {_metavar(action)}".strip().replace("|", "\\|")
    return f"| `{name}` | {'; '.join(filter(None, parts))} |"


if __name__ == "__main__":
    made = document()
    sys.stdout.write(made)
    if TRAINING not in made:
        print(WITHOUT_TRAINING, file=sys.stderr)
