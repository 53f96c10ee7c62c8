"""With which client of the arm's controller a test runs: in `make test` with the one that it names, in `make test-all` with each.

@pytest.mark.client("koala")     the other client is left to `make test-all`
@pytest.mark.both_clients        both are in `make test` too

The mark may stand at the test, at its file, or at single parameters where the file has another one.
"""

import importlib.util
from collections.abc import Generator
from typing import Any

import pytest

CLIENTS = ("ur_rtde", "koala")
INSTALLED = CLIENTS if importlib.util.find_spec("rtde_control") else ("koala",)
"""The vendor's client has no wheel for some Pythons and platforms; tests that name it run with the other one there."""


@pytest.fixture(params=INSTALLED)
def client(request: pytest.FixtureRequest) -> str:
    """Each client in turn."""
    return request.param


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makeitem() -> Generator[None, Any, Any]:
    """Of the tests that take `client`, leave those with the other one to `make test-all`."""
    made = yield
    for item in made if isinstance(made, list) else []:
        leave_other_client(item)
    return made


def leave_other_client(item: pytest.Item) -> None:
    """Mark a test as slow if it is given another client than it names. Raises CollectError: it is given one and names none."""
    given = item.callspec.params.get("client") if isinstance(item, pytest.Function) and hasattr(item, "callspec") else None
    if given is None or item.get_closest_marker("both_clients"):
        return
    mark = item.get_closest_marker("client")
    if mark is None or mark.args not in [(name,) for name in CLIENTS]:
        remedy = " or ".join(f"@pytest.mark.client({name!r})" for name in CLIENTS)
        raise pytest.Collector.CollectError(f"{item.name} takes 'client' and does not say which: {remedy}, or both_clients")
    if given != mark.args[0] and mark.args[0] in INSTALLED:
        item.add_marker("slow")
