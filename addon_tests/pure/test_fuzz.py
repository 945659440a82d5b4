"""The targets of the fuzzer hold for a few examples each, and for everything that it has ever found."""

import pytest

from addon_tests.fuzz import CORPUS, targets, tried
from addon_tests.fuzz_readers import readers

FOUND = sorted(CORPUS.glob("*.bin"))


@pytest.mark.parametrize("name", list(targets()))
def test_a_target_holds(name):
    n_examples, _ = tried(*targets()[name], number=0, n_examples=30)
    assert n_examples >= 25


@pytest.mark.parametrize("file", FOUND, ids=lambda file: file.stem)
def test_what_was_found_once_is_mended(file):
    _, reader = readers()[file.stem.split("-")[0]]
    assert reader(file.read_bytes()) is None


def test_the_corpus_is_there_and_small():
    assert FOUND
    assert all(file.stat().st_size < 10_000 for file in FOUND)


def test_a_property_that_does_not_hold_is_found_with_its_example():
    strategy, _ = readers()["wire_float32"]

    def never_empty(payload):
        assert len(payload) > 20

    with pytest.raises(AssertionError) as found:
        tried(strategy, never_empty, number=0, n_examples=100)
    assert len(found.value.example) <= 20
