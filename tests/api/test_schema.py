"""Requests made from the OpenAPI schema: none is answered by a 5xx or outside the schema."""

import json
import os
from contextlib import suppress

import httpx
import hypothesis
import pytest
import schemathesis
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import status_code_conformance

CASES = int(os.environ.get("SCHEMA_CASES", "4"))
"""Cases of each route; the long run takes 500."""


def test_requests_of_the_schema_are_answered_within_it(server, record_property):
    schema = schemathesis.openapi.from_url(f"{server.url}/openapi.json")
    n_routes = n_cases = 0
    for result in schema.get_all_operations():
        operation = result.ok()
        n_routes += 1

        @hypothesis.seed(1)
        @hypothesis.settings(
            max_examples=CASES,
            deadline=None,
            database=None,
            suppress_health_check=list(hypothesis.HealthCheck),
        )
        @hypothesis.given(case=operation.as_strategy())
        def answers(case):
            nonlocal n_cases
            n_cases += 1
            response = case.call()
            case.validate_response(response, checks=(not_a_server_error, status_code_conformance))

        answers()
    assert n_routes >= 18
    record_property("cases", n_cases)


@pytest.mark.slow
def test_wrong_requests_of_the_schema_are_no_server_errors(server, record_property):
    """Also requests that break the schema; texts stand for files, which the generator lacks."""
    text = httpx.get(f"{server.url}/openapi.json").text.replace(',"format":"binary"', "")
    assert '"binary"' not in text
    schema = schemathesis.openapi.from_dict(json.loads(text))
    schema.config.update(base_url=server.url)
    n_cases = 0
    for result in schema.get_all_operations():
        operation = result.ok()

        @hypothesis.settings(
            max_examples=CASES * 10, deadline=None, database=None,
            suppress_health_check=list(hypothesis.HealthCheck),
        )  # fmt: skip
        @hypothesis.given(
            case=operation.as_strategy(generation_mode=schemathesis.GenerationMode.NEGATIVE)
        )
        def answers(case):
            nonlocal n_cases
            n_cases += 1
            case.validate_response(case.call(), checks=(not_a_server_error,))

        with suppress(hypothesis.errors.Unsatisfiable):  # a route without parameters
            answers()
    assert n_cases > CASES * 10
    record_property("cases", n_cases)
