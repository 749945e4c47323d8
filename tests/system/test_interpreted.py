"""Interpreted kernels give the bits, the counts and the ticks of compiled ones, in every part of the machine that has kernels.

So what a debugger shows, and what is counted of lines (`make check-interpreted`), is what compiled code does. One process has the one
kind of kernels, this one the other, whichever that is.
"""

from __future__ import annotations

import pytest
from support.twins import CASES, Facts, facts_of, facts_of_the_others

pytestmark = [pytest.mark.timeout(900), pytest.mark.filterwarnings("ignore::RuntimeWarning")]


@pytest.fixture(scope="module")
def others() -> dict[str, Facts]:
    """The facts of kernels of the other kind."""
    return facts_of_the_others()


@pytest.mark.parametrize("case", CASES)
def test_interpreted_and_compiled_kernels_give_the_same(case: str, others: dict[str, Facts]) -> None:
    assert facts_of(case) == others[case]
