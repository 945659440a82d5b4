"""The README is short, and what it and the docs tell people to type or to click on exists."""

import importlib.util
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from addon_tests.pure.recordings import SMALL, looking, seen
from xihe_blender.cli.document import TRAINING, WITHOUT_TRAINING, document
from xihe_blender.cli.main import command_parser
from xihe_blender.io.run_results import METRICS
from xihe_blender.previs.presets import PRESETS
from xihe_blender.report.plots import CHAIN, IT_REFLECTS, STAGES
from xihenet import __version__, controller, estimators
from xihenet.captures.reading import READERS
from xihenet.captures.replay import REPLAY_TRIGGER
from xihenet.formats import format_list
from xihenet.light.platforms import PLATFORMS
from xihenet.phone import LINKS, PHONE_EFFECTS, profile_names
from xihenet.trigger import RULES

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS]
MOST_WORDS = 900


def commands_of(page):
    """What a page tells people to type, in blocks marked as `sh`; a backslash at its end joins a line to the next."""
    blocks = re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    return [command for line in lines if (command := line.split(" #")[0].strip())]


def python_of(page):
    """The blocks of a page that are marked as `python`, or the one script that it is."""
    text = page.read_text(encoding="utf-8")
    return [text] if page.suffix == ".py" else re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def words_of(*beginning):
    """Commands of all pages that begin with these words, without them."""
    split = [shlex.split(command) for command in COMMANDS]
    return [words[len(beginning) :] for words in split if tuple(words[: len(beginning)]) == beginning]


COMMANDS = list(dict.fromkeys(command for page in PAGES for command in commands_of(page)))
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


def shown(words):
    return " ".join(words)


@pytest.mark.parametrize("page", [ROOT / "CHANGELOG.md", *PAGES], ids=lambda page: page.name)
def test_no_page_has_marks_of_a_merge(page):
    assert not re.findall(r"^(?:<{7}|={7}$|>{7}).*", page.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_line_of_a_paragraph_begins_as_a_quotation(page):
    """As "**Camera Path > Whole Path**" does where its line ends before the mark."""
    assert not re.findall(r"^ *[^ >\n].*\n *> ", page.read_text(encoding="utf-8"), re.MULTILINE)


def test_the_readme_is_short():
    assert len(README.split()) <= MOST_WORDS


def test_the_readme_has_two_pictures_and_one_table():
    """The panel, and what objects look like."""
    assert len(re.findall(r"!\[", README)) == 2
    assert len(re.findall(r"^\| ?---", README, re.MULTILINE)) == 1


def test_the_readme_leads_to_the_two_commands():
    typed = commands_of(ROOT / "README.md")
    assert [command.split()[:2] for command in typed if "previs" in command] == [["make", "previs"], ["xihe", "previs"]]


SESSIONS = [ROOT / "docs" / name for name in ("python.md", "edge.md", "session_without_blender.py")]


@pytest.mark.parametrize("page", SESSIONS, ids=lambda page: page.name)
def test_sessions_of_the_docs_have_the_settings_of_the_commands(page):
    """Those of `xihe replay`: all of the light, its trigger, and what is learned while a position is out of view."""
    trigger = f"TriggerSettings(theta={REPLAY_TRIGGER.theta}, ignored_share={REPLAY_TRIGGER.ignored_share})"
    sessions = [block for block in python_of(page) if "XiheController(" in block]
    assert sessions
    for one in sessions:
        assert all(words in one for words in ('target="hdr"', trigger, "(trigger, learns_out_of_view=True)"))


def test_the_session_of_the_docs_runs():
    known = {"frame": seen(SMALL, looking(1.57, 0.4, (0.0, 0.0, 0.1)))}
    exec(next(block for block in python_of(ROOT / "docs" / "python.md") if "XiheController(" in block), known)
    assert known["session"].backend.estimator.target == "hdr" and known["session"].settings.learns_out_of_view
    assert known["session"].settings.trigger == REPLAY_TRIGGER


def test_what_the_docs_import_from_xihenet_exists():
    blocks = "\n".join(block for page in DOCS for block in python_of(page))
    lines = re.findall(r"^(?:from|import) xihenet.*", blocks, re.MULTILINE)
    assert lines
    for line in lines:
        exec(line)


def test_the_folder_that_make_is_given_may_have_spaces_in_its_name():
    assert set(re.findall(r".\$\(OUT\)", (ROOT / "Makefile").read_text(encoding="utf-8"))) == {'"$(OUT)'}


@pytest.mark.parametrize("words", words_of("make"), ids=shown)
def test_make_targets_of_the_docs_exist(words):
    targets = [word for word in words if "=" not in word]
    assert targets and set(targets) <= TARGETS


@pytest.mark.parametrize("words", [w for w in words_of("xihe") if w[0] != "train"], ids=shown)
def test_xihe_commands_of_the_docs_are_understood(words):
    options = command_parser().parse_args(words)
    scene = getattr(options, "scene", None)
    assert scene is None or not str(scene).startswith("blend_scenes") or (ROOT / scene).exists()


@pytest.mark.parametrize("words", words_of("blender", "--command", "xihe"), ids=shown)
def test_the_same_holds_inside_blender(words):
    assert command_parser().parse_args(words).command == words[0]


def test_the_docs_name_the_extension_as_it_is_built():
    named = {name for page in PAGES for name in re.findall(r"xihe-[\d.]+\.zip", page.read_text(encoding="utf-8"))}
    assert named == {f"xihe-{__version__}.zip"}


def test_scripts_of_the_docs_exist():
    in_blender = [words[words.index("--python") + 1] for words in words_of("blender") if "--python" in words]
    in_python = [words[0] for words in words_of("python") if words[0] != "-m"]
    assert in_blender and in_python
    assert all((ROOT / script).exists() for script in in_blender + in_python)


@pytest.mark.parametrize("words", [w for w in words_of("python", "-m") if w[0].startswith("xihe")], ids=shown)
def test_modules_that_the_docs_start_exist(words):
    assert importlib.util.find_spec(words[0]) is not None


def test_every_command_of_the_docs_is_of_a_kind_that_is_tested_here():
    kinds = {command.split()[0] for command in COMMANDS}
    assert kinds <= {"make", "xihe", "blender", "python", "pip", "source", "dask"}
    assert words_of("source") == [[".venv/bin/activate"]]


def test_extras_that_the_docs_install_exist():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = {extra for extras in re.findall(r'pip install "?\.\[([\w,]+)\]', text) for extra in extras.split(",")}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert named <= set(project["optional-dependencies"])


OTHERS = [ROOT / name for name in ("CHANGELOG.md", "xihenet/weights/README.md", "blend_scenes/README.md")]


@pytest.mark.parametrize("page", [*PAGES, *OTHERS], ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings_that_exist(page):
    broken = [link for link in links_of(page.read_text(encoding="utf-8")) if not is_found(page, link)]
    assert not broken


def links_of(text):
    """Targets of the links and pictures that lead to other places of the repository, or of the page itself."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.findall(r"\]\((?!https?:|mailto:)([^)\s]+)\)", prose)


def is_found(page, link):
    path, _, heading = link.partition("#")
    target = page.parent / path if path else page
    return target.exists() and (not heading or heading in headings_of(target.read_text(encoding="utf-8")))


def headings_of(text):
    """Anchors of a page's headings as GitHub makes them: small letters and hyphens, other signs dropped."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    titles = re.findall(r"^#+ (.*)$", prose, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def test_a_link_to_nowhere_is_seen():
    text = (
        "# What `make bench` measures, and why\n[a](docs/gone.md) [b](#what-make-bench-measures-and-why) [c](#gone)\n"
    )
    assert links_of(text) == ["docs/gone.md", "#what-make-bench-measures-and-why", "#gone"]
    assert headings_of(text) == {"what-make-bench-measures-and-why"}
    assert not is_found(ROOT / "README.md", "docs/gone.md") and not is_found(ROOT / "README.md", "LICENSE#gone")


def test_the_index_names_every_page_once():
    linked = [link for link in links_of((ROOT / "docs/index.md").read_text(encoding="utf-8")) if "/" not in link]
    pages = [link for link in linked if link.endswith(".md")]
    assert sorted(pages) == sorted(page.name for page in DOCS if page.name != "index.md")


@pytest.mark.parametrize(
    ("page", "names"),
    [
        ("previs.md", [*estimators.names(), *PRESETS]),
        ("trigger.md", RULES),
        ("phone.md", [*profile_names(), *LINKS, *PHONE_EFFECTS]),
        ("platforms.md", PLATFORMS),
        ("results.md", METRICS),
    ],
)
def test_a_page_names_all_that_can_be_chosen_or_read(page, names):
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert [name for name in names if f"`{name}`" not in text] == []


@pytest.mark.parametrize("name", ["noise_target", "comparison_samples"])
def test_the_page_on_runs_has_the_numbers_of_the_presets(name):
    page = " ".join((ROOT / "docs" / "previs.md").read_text(encoding="utf-8").split())
    assert format_list([f"{getattr(preset, name):g}" for preset in PRESETS.values()]) in page


def test_the_chain_has_the_same_words_everywhere():
    chain, (previs, conventions) = (
        list(CHAIN),
        ((ROOT / "docs" / f"{name}.md").read_text() for name in ("previs", "conventions")),
    )
    assert " → ".join(chain) in " ".join(README.split())
    stages = previs.split("## What a run does")[1].split("##")[0]
    said = re.findall(r"^\| (\w[\w ]*) \| (.*) \|$", stages, re.MULTILINE)[1:]
    assert [name for name, _ in said] == chain and all(words.startswith(CHAIN[name]) for name, words in said)
    assert IT_REFLECTS in " ".join(stages.split())
    where = conventions.split("## Where is what")[1].split("`xihenet`, by what")[0]
    listed = ", ".join(re.findall(r"^\| (\w[^|]*) \|", where, re.MULTILINE)).split(", ")
    assert [word for word in listed if word in chain] == chain
    assert ", ".join(STAGES[:-1]) in controller.__doc__


def test_what_contributing_says_to_touch_is_there():
    text, rooms = CONTRIBUTING.split("## How to add")[1], ("xihenet", "xihe_blender", "addon_tests")
    sources = "\n".join(path.read_text(encoding="utf-8") for room in rooms for path in (ROOT / room).rglob("*.py"))
    assert [name for name in set(re.findall(r"`(\w+)`", text)) if name not in sources] == []
    files = {file for file in re.findall(r"`([\w/]+\.(?:py|md|json))`", text) if "NAME" not in file}
    paths = [path.relative_to(ROOT).as_posix() for room in (*rooms, "docs") for path in (ROOT / room).rglob("*.*")]
    assert files and [file for file in files if not any(f"/{path}".endswith(f"/{file}") for path in paths)] == []


def test_the_page_on_recordings_names_every_format():
    text = (ROOT / "docs/captures.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| (?:a )?([^,|]+?)(?:,[^|]*)? \|", text.split("## What is read")[1], re.MULTILINE)
    assert set(READERS) - {"Xihe session"} <= set(listed) and "our own" in listed


def test_the_page_of_the_command_line_is_made_from_the_parsers():
    page = (ROOT / "docs/cli.md").read_text(encoding="utf-8")
    made = document()
    # Without torch the last part, on training, is not made; the tests of torch compare all of it.
    assert page.startswith(made), "run: python -m xihe_blender.cli.document > docs/cli.md"
    assert TRAINING in page, WITHOUT_TRAINING
    assert made == page or page[len(made) :].startswith(TRAINING)


def test_help_has_the_defaults_of_the_page(capsys):
    with pytest.raises(SystemExit):
        command_parser("previs").parse_args(["previs", "--help"])
    shown_help = " ".join(capsys.readouterr().out.split())
    assert "how much is rendered; default: balanced" in shown_help
    assert "the same seed gives the same numbers; default: 0" in shown_help


def test_contributing_says_why_tests_are_skipped():
    marks = [
        mark
        for file in sorted((ROOT / "addon_tests").rglob("test_*.py"))
        if file != Path(__file__)
        for mark in re.findall(
            r"mark\.(?:skip|xfail).*|\bimportorskip.*|pytest\.skip.*", file.read_text(encoding="utf-8")
        )
    ]
    for mark in marks:
        reason = re.search(r'reason="([^"]+)"', mark)
        assert reason is not None and reason[1] in CONTRIBUTING, mark
