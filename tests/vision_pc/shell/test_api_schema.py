"""The REST face against its own schema, by schemathesis: no 5xx, and every refusal a problem document.

Requests are made from the schema, and others that break it; more of them as an experiment.
"""

import contextlib
from collections import Counter

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given
from hypothesis import settings as hypothesis_settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode

from tests.vision_pc.shell.rest_server import rest_face

# A stream lasts as long as its client, and one that waits is no finding.
_ENDLESS = ("/events", "/camera/live")


def answered(examples: int) -> Counter[str]:
    """How often each operation was answered with each status; asserts that none of them is a 5xx."""
    counts: Counter[str] = Counter()
    with rest_face() as url:
        schema = schemathesis.openapi.from_url(f"{url}/openapi.json")
        for found in schema.get_all_operations():
            operation = found.ok()
            if operation.path in _ENDLESS:
                continue
            for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
                _try(operation, mode, examples, counts)
    return counts


def _try(
    operation: schemathesis.APIOperation, mode: GenerationMode, examples: int, counts: Counter[str]
) -> None:
    @hypothesis_settings(
        max_examples=examples,
        deadline=None,
        database=None,
        phases=(Phase.explicit, Phase.generate),
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=mode))
    def asked(case: schemathesis.Case) -> None:
        response = case.call(timeout=20.0)
        counts[f"{operation.method.upper()} {operation.path} {response.status_code}"] += 1
        assert response.status_code < 500, (case.as_curl_command(), response.text)
        if response.status_code >= 400:
            assert response.headers["content-type"][0] == "application/problem+json", response.text
            assert response.json()["cause"]

    with contextlib.suppress(Unsatisfiable):  # an operation without parameters cannot be asked wrongly
        asked()


@pytest.mark.slow("every route is asked, rightly and wrongly")
def test_no_request_is_answered_with_a_server_error() -> None:
    counts = answered(4)
    assert sum(counts.values()) > 80
    assert {name.split(" ")[0] for name in counts} == {"GET", "POST", "PUT", "DELETE"}


@pytest.mark.experiment
def test_thousands_of_requests_are_answered_without_a_server_error() -> None:
    counts = answered(200)
    print()
    for name, count in sorted(counts.items()):
        print(f"{count:>6}  {name}")
    print(f"{sum(counts.values())} requests, no 5xx")
