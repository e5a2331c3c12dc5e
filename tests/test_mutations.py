"""The benchmark that changes definitions finds each of them."""

from __future__ import annotations

import pytest
from places import ROOT

from benchmarks.mutations import MUTATIONS, Mutation


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.what)
def test_every_mutation_has_its_line_and_its_tests(mutation: Mutation) -> None:
    mutation.mutated(ROOT)
    for path in mutation.tests.split():
        assert (ROOT / path).is_file()


def test_all_packages_are_mutated() -> None:
    files = [mutation.file.partition("/")[0] for mutation in MUTATIONS]
    assert set(files) == {"lensdesign", "wavesim", "tolerancing"}
    assert len(MUTATIONS) >= 30
