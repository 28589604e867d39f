"""What programs see of the service: its schema, headers of answers, parts of results."""

import runpy

import pytest
from starlette.testclient import TestClient

from api.app import create_app
from api.errors import Problem
from api.guard.keys import digest_of
from api.messages import formats as messages
from api.routes.jobs import part_of
from api.settings import ApiKey, Settings
from tests.api.conftest import KEYS, bearer, wav
from tests.api.server import wait_for
from tests.api.test_jobs import submit, wait


@pytest.fixture(scope="module")
def schema(server):
    with server.client() as client:
        return client.get("/openapi.json").json()


def operations(schema):
    return [route for methods in schema["paths"].values() for route in methods.values()]


def test_every_operation_has_a_name_of_its_own_and_every_answer_its_headers(schema):
    names = [route["operationId"] for route in operations(schema)]
    assert len(set(names)) == len(names) and {"animate", "create_job", "job_result"} <= set(names)
    for route in operations(schema):
        for status, answer in route["responses"].items():
            assert "X-Request-ID" in answer["headers"], (route["operationId"], status)
            assert ("Retry-After" in answer["headers"]) == (status in ("429", "503", "507"))
            assert ("Location" in answer["headers"]) == (status == "202")
    result = schema["paths"]["/v1/jobs/{job_id}/result"]["get"]["responses"]
    assert {"ETag", "Content-Range"} <= set(result["206"]["headers"])


def test_formats_and_models_are_listed_where_they_are_chosen(schema, client):
    formats = client.get("/v1/formats").json()
    models = [model["name"] for model in client.get("/v1/models").json()]
    for path, kind in (("/v1/animations", "animations"), ("/v1/meshes", "meshes")):
        route = schema["paths"][path]["post"]
        form = route["requestBody"]["content"]["multipart/form-data"]["schema"]["properties"]
        query = {option["name"]: option["schema"] for option in route["parameters"]}
        for options in (form, query):
            assert options["format"]["enum"] == [known["name"] for known in formats[kind]]
            assert options["model"]["enum"] == models


def test_usd_is_offered_only_where_it_can_be_made(monkeypatch):
    assert "usd" in messages.ANIMATION_FORMATS
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "usd" not in runpy.run_path(messages.__file__)["ANIMATION_FORMATS"]


@pytest.mark.parametrize(
    ("header", "part"),
    [
        ("bytes=0-9", (0, 10)), ("bytes=90-", (90, 100)), ("bytes=-5", (95, 100)),
        ("bytes=-500", (0, 100)), ("bytes=99-200", (99, 100)), ("bytes=5-4", (0, 100)),
        ("bytes=1-2,4-5", (0, 100)), ("items=0-9", (0, 100)), ("bytes=-", (0, 100)),
        (None, (0, 100)),
    ],
)  # fmt: skip
def test_part_of_a_file_is_that_of_rfc_9110(header, part):
    assert part_of(header, 100) == part


@pytest.mark.parametrize("header", ["bytes=100-", "bytes=-0", "bytes=500-600"])
def test_part_beyond_a_file_is_refused_with_its_size(header):
    with pytest.raises(Problem) as refused:
        part_of(header, 100)
    assert refused.value.status == 416
    assert refused.value.headers["Content-Range"] == "bytes */100"


def test_results_are_sent_in_parts_and_only_if_they_are_new(client):
    job = wait(client, submit(client, recording=wav(2.0), format="csv").json()["id"])
    whole = client.get(job["result"])
    size, tag = job["result_bytes"], whole.headers["etag"]
    part = client.get(job["result"], headers={"Range": f"bytes=100-{size + 7}", "If-Range": tag})
    assert part.status_code == 206 and part.content == whole.content[100:]
    assert part.headers["content-range"] == f"bytes 100-{size - 1}/{size}"
    other = client.get(job["result"], headers={"Range": "bytes=100-", "If-Range": '"other"'})
    assert other.status_code == 200 and other.content == whole.content
    for known in (tag, f'"other", W/{tag}', "*"):
        assert client.get(job["result"], headers={"If-None-Match": known}).status_code == 304
    assert client.get(job["result"], headers={"Range": f"bytes={size}-"}).status_code == 416


def test_head_has_the_headers_of_get_and_no_body(client):
    job = wait(client, submit(client, recording=wav(0.5), format="csv").json()["id"])
    for path in ("/healthz", "/v1/models", "/v1/formats", job["result"]):
        head, get = client.head(path), client.get(path)
        assert (head.status_code, head.content) == (200, b"")
        for name in ("content-length", "content-type", "etag"):
            assert head.headers.get(name) == get.headers.get(name), (path, name)
    assert client.head("/v1/none").status_code == 404
    assert client.delete("/v1/models").headers["allow"] == "GET, HEAD"


def test_pages_of_the_sites_of_origins_may_call_and_read():
    """A browser asks without a key, by OPTIONS, and shows a page what it is allowed to."""
    key = ApiKey(name="farm", sha256=digest_of(KEYS["farm"]))
    settings = Settings(origins=("https://app.example",), keys=(key,))
    client = TestClient(create_app(settings), base_url="http://127.0.0.1")
    asked = {
        "Access-Control-Request-Method": "POST",
        "Access-Control-Request-Headers": "authorization,content-type,idempotency-key",
    }
    allowed = client.options("/v1/jobs", headers=asked | {"Origin": "https://app.example"})
    assert allowed.status_code == 200
    assert allowed.headers["access-control-allow-origin"] == "https://app.example"
    assert "access-control-allow-credentials" not in allowed.headers
    for keys, status in ((bearer("farm"), 200), ({}, 401)):
        answer = client.get("/v1/emotions", headers=keys | {"Origin": "https://app.example"})
        assert answer.status_code == status
        assert answer.headers["access-control-allow-origin"] == "https://app.example"
        assert "deitalk-notes" in answer.headers["access-control-expose-headers"].lower()
    for headers in ({}, asked):
        other = client.options("/v1/jobs", headers=headers | {"Origin": "https://evil.example"})
        assert other.status_code in (400, 403)
        assert "access-control-allow-origin" not in other.headers


def test_video_becomes_a_job_by_itself(client):
    """A second of it is seconds of work: no client waits for that, and no worker is held."""
    answer = client.post("/v1/animations?format=mp4", content=wav(3.5))
    assert answer.status_code == 202 and answer.headers["location"].startswith("/v1/jobs/")
    client.post(answer.headers["location"] + "/cancel")
    assert client.post("/v1/animations?format=csv", content=wav(3.5)).status_code == 200


def test_spans_of_a_request_and_its_job_are_one_trace_at_the_collector(observed):
    """OpenTelemetry's own messages, read by its own definitions; nothing of what was sent in them."""
    messages = pytest.importorskip(
        "opentelemetry.proto.collector.trace.v1.trace_service_pb2", reason="needs the extra otel"
    )
    trace = "0af7651916cd43dd8448eb211c80319c"
    given = {"traceparent": f"00-{trace}-b7ad6b7169203331-01", "X-Request-ID": "shot-7"}
    with observed.server.client(headers=bearer("farm")) as client:
        job = submit(client, recording=wav(1.0), headers=given, name="secret")
        wait(client, job.json()["id"])
    read, spans = messages.ExportTraceServiceRequest.FromString, []

    def job_is_told():
        sent = [each for _, body in observed.spans.calls for each in read(body).resource_spans]
        spans[:] = [span for each in sent for scope in each.scope_spans for span in scope.spans]
        return "job" in {span.name for span in spans if span.trace_id.hex() == trace}

    wait_for(job_is_told)
    own = {span.name: span for span in spans if span.trace_id.hex() == trace}
    assert set(own) == {"POST /v1/jobs", "job"}
    assert own["job"].parent_span_id == own["POST /v1/jobs"].span_id
    assert own["POST /v1/jobs"].parent_span_id.hex() == "b7ad6b7169203331"
    facts = {pair.key: pair.value for pair in own["POST /v1/jobs"].attributes}
    assert facts["http.response.status_code"].int_value == 202
    assert facts["deitalk.request"].string_value == "shot-7"
    assert "secret" not in str(spans) and job.json()["id"] not in str(spans)
