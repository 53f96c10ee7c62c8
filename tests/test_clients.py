"""Which client of the arm's controller a test gets: the rule is tried on these tests themselves."""

import pytest

from tests import clients
from tests.clients import leave_other_client


@pytest.mark.parametrize("named", [pytest.param(name, marks=pytest.mark.client(name)) for name in clients.CLIENTS])
def test_the_client_that_is_not_named_is_slow(client: str, named: str, request: pytest.FixtureRequest) -> None:
    slow = request.node.get_closest_marker("slow") is not None
    assert slow == (client != named and named in clients.INSTALLED)


@pytest.mark.both_clients
def test_neither_is_slow_with_both(client: str, request: pytest.FixtureRequest) -> None:
    assert client in clients.INSTALLED and request.node.get_closest_marker("slow") is None


@pytest.mark.client("koala")
def test_ours_stands_in_for_one_that_is_not_installed(
    client: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clients, "INSTALLED", ("koala",))
    request.node.own_markers[:] = [pytest.mark.client("ur_rtde").mark]
    leave_other_client(request.node)
    assert request.node.get_closest_marker("slow") is None


@pytest.mark.client("koala")
@pytest.mark.parametrize("said", [[], [pytest.mark.client("koalla").mark], [pytest.mark.client().mark]])
def test_a_test_that_names_none_is_refused(client: str, said: list[pytest.Mark], request: pytest.FixtureRequest) -> None:
    request.node.own_markers[:] = said
    with pytest.raises(pytest.Collector.CollectError, match=r"names_none_is_refused\[.*does not say which.*client\('koala'\)"):
        leave_other_client(request.node)
