"""What unit tests share."""

from collections.abc import Iterator

import pytest

from commonlaw.estimation import search


@pytest.fixture(scope="module")
def few_starts() -> Iterator[None]:
    """Few first values, for likelihoods of one maximum that is found from most of them."""
    with pytest.MonkeyPatch.context() as patch:
        for name, count in {"DRAWS": 16, "IMPROVED": 4, "FINISHED": 2}.items():
            patch.setattr(search, name, count)
        yield
