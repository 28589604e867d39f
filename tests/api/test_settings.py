"""Settings, keys, rates and formats without a server."""

import asyncio
import json
import queue
import re
import socket
import tomllib
from pathlib import Path

import pytest
import uvicorn
import yaml
from pydantic import ValidationError
from typer.testing import CliRunner

import api
from api import commands, serving
from api.app import create_app
from api.errors import Problem
from api.guard.keys import KEY_PREFIX, Rates, digest_of, new_key
from api.guard.metrics import Metrics
from api.guard.middleware import Guard, Traffic
from api.messages.formats import ANIMATION_FORMATS, choose_format
from api.messages.options import (
    AnimationOptions,
    ConversionOptions,
    DiffOptions,
    RetargetOptions,
)
from api.serving import check_places
from api.settings import ApiKey, Settings, load_settings
from deitalk.cli import app
from deitalk.config.curves import ModelConfig
from deitalk.config.section import rule
from deitalk.errors import ConfigError, DeitalkError
from tests.browser import needs_player
from tests.command import ran
from tests.errors import one_line


def test_later_sources_replace_earlier_ones(tmp_path, monkeypatch):
    file = tmp_path / "service.yaml"
    file.write_text("port: 8001\nworkers: 3\nmax_seconds: 30\n")
    monkeypatch.setenv("DEITALK_WORKERS", "2")
    settings = load_settings(file, port=8002, host=None)
    assert (settings.port, settings.workers, settings.max_seconds) == (8002, 2, 30)
    assert settings.host == "127.0.0.1" and settings.is_local


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("prot: 1", "prot"),
        ("port: 99999", "port"),
        ("keys: [{name: a}]", "keys"),
        ("- 1", "lines"),
        ("device: gpu", "cuda:N"),
    ],
)
def test_wrong_settings_are_named(tmp_path, text, named):
    file = tmp_path / "service.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=named):
        load_settings(file)


@pytest.mark.parametrize(
    ("model", "field", "value", "words"),
    [
        (AnimationOptions, "name", "a/b", "1 to 64 of A to Z"),
        (AnimationOptions, "timecode", "10:00", "HH:MM:SS:FF"),
        (AnimationOptions, "language", "e", "voice of espeak-ng"),
        (DiffOptions, "name", "-a", "a letter or digit first"),
        (ConversionOptions, "name", "a\n", "1 to 64 of A to Z"),
        (RetargetOptions, "method", "by hand", "'displacements' or 'gradients'"),
        (ApiKey, "name", "a b", "1 to 40 of A to Z"),
        (ApiKey, "sha256", "A" * 64, "64 of 0 to 9, a to f"),
        (ModelConfig, "own_decoder", "mine", "module:Class"),
    ],
)
def test_the_rule_of_a_text_is_stated_in_words(model, field, value, words):
    """The regular expressions of schemas are for programs."""
    with pytest.raises(ValidationError) as caught:
        model(**{field: value})
    (found,) = [rule(item) for item in caught.value.errors() if item["loc"][0] == field]
    assert words in found and "[" not in found and "Value error" not in found


@pytest.mark.parametrize(
    ("given", "backend"),
    [
        ({}, "auto"),
        ({"backend": "onnx"}, "onnx"),
        ({"live_backend": "torch"}, "torch"),
        ({"backend": "onnx", "live_backend": "torch"}, "torch"),
        ({"live_backend": "onnx"}, "onnx"),
    ],
)
def test_backend_of_live_sessions(given, backend):
    assert load_settings(None, **given).backend_of_live == backend


def test_device_that_is_missing_is_named_before_the_start(tmp_path):
    with one_line(DeitalkError, "cuda:99", "use cpu"):
        serving.run(Settings(device="cuda:99", data=tmp_path))


def test_other_addresses_need_keys(tmp_path):
    with pytest.raises(ConfigError, match="key"):
        create_app(Settings(host="0.0.0.0", data=tmp_path))
    entry = {"name": "farm", "sha256": digest_of("dk_x")}
    assert create_app(Settings(host="0.0.0.0", data=tmp_path, keys=[entry])) is not None


def test_printed_settings_hold_no_secret(tmp_path):
    secret = digest_of("dk_x")
    settings = Settings(
        data=tmp_path,
        keys=[{"name": "farm", "sha256": secret}],
        database="postgresql+psycopg://user:hunter2@host/db",
        storage="s3://id:hunter2@bucket/x",
    )
    text = "\n".join(settings.lines())
    assert "hunter2" not in text and secret not in text and "keys = farm" in text
    assert secret not in repr(settings)


def test_new_keys_differ_and_are_accepted_by_their_settings(tmp_path):
    printed = CliRunner().invoke(app, ["serve", "key", "farm", "--scopes", "animate,jobs"]).stdout
    key, _, entry = printed.partition("\n\n")
    (tmp_path / "service.yaml").write_text(entry)
    (known,) = load_settings(tmp_path / "service.yaml").keys
    assert key.startswith(KEY_PREFIX) and known.sha256 == digest_of(key)
    assert known.scopes == ("animate", "jobs")
    assert len({new_key()[0] for _ in range(100)}) == 100


def test_rate_refills_evenly(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("api.guard.keys.monotonic", lambda: now[0])
    rates = Rates()
    for _ in range(6):  # a tenth of the minute at once
        rates.take("a", 60)
    with pytest.raises(Problem) as refused:
        rates.take("a", 60)
    assert refused.value.status == 429 and refused.value.headers["Retry-After"] == "1"
    rates.take("b", 60)
    now[0] += 1.0
    rates.take("a", 60)


@pytest.mark.parametrize(
    ("accept", "expected"),
    [
        (None, "json"), ("*/*", "json"), ("text/csv", "csv"), ("model/gltf-binary", "glb"),
        ("text/html;q=0.1, application/zip", "take"), ("video/*", "mp4"),
        ("image/png, text/csv;q=0.5", "csv"), ("application/x-npz", "npz"),
    ],
)  # fmt: skip
def test_accept_header_chooses_the_format(accept, expected):
    assert choose_format(ANIMATION_FORMATS, None, accept, "json").name == expected


def test_hosts_of_loopback_are_known_by_every_spelling(tmp_path):
    async def passed(scope, receive, send):
        pass

    guard = Guard(passed, Settings(data=tmp_path), Metrics(), Traffic(9))
    for host in ("localhost:8000", "127.0.0.1", "[::1]:8000", "127.0.0.2:1"):
        assert asyncio.run(_answer(guard, "/v1/models", host)) == 200, host
    for host in ("evil.example", "", "localhost.evil.example", "a b", "1" * 300):
        assert asyncio.run(_answer(guard, "/v1/models", host)) == 403, host


async def _answer(guard, path, host):
    """Status of a request; 200 where the guard passes it on."""
    sent = []

    async def send(message):
        sent.append(message)

    scope = {"type": "http", "method": "GET", "path": path, "state": {}}
    await guard(scope | {"headers": [(b"host", host.encode())]}, None, send)
    return sent[0]["status"] if sent else 200


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "10.0.0.7", "[::1]:8000"])
def test_probes_by_address_are_answered_where_hosts_names_the_service(tmp_path, host):
    """The container's own check, and that of a balancer."""

    async def passed(scope, receive, send):
        pass

    entry = {"name": "farm", "sha256": digest_of("dk_key"), "scopes": ["animate"]}
    settings = Settings(host="0.0.0.0", data=tmp_path, keys=[entry], hosts=["voice.example"])
    guard = Guard(passed, settings, Metrics(), Traffic(9))
    for path in ("/healthz", "/readyz"):
        assert asyncio.run(_answer(guard, path, host)) == 200
        assert asyncio.run(_answer(guard, path, "voice.example")) == 200
        for other in ("evil.example", "", "[x", "1.2.3.4.evil.example"):
            assert asyncio.run(_answer(guard, path, other)) == 403
    assert asyncio.run(_answer(guard, "/v1/models", host)) == 403


def test_command_writes_the_schema(tmp_path):
    out = tmp_path / "openapi.json"
    ran("serve", "openapi", "-o", out)
    schema = json.loads(out.read_text())
    assert schema["openapi"].startswith("3.") and "/v1/animations" in schema["paths"]
    body = schema["paths"]["/v1/animations"]["post"]["requestBody"]["content"]
    form = body["multipart/form-data"]["schema"]
    assert form["required"] == ["recording"] and "emotion" in form["properties"]
    for path in schema["paths"]:
        assert path.startswith("/v1/") or path in ("/healthz", "/readyz", "/metrics")


def test_container_files_name_settings_that_exist():
    folder = Path(api.__file__).parent / "container"
    compose = yaml.safe_load((folder / "compose.yaml").read_text())
    text = (folder / "Dockerfile").read_text()
    services = compose["services"]
    given = [services[name]["environment"] for name in ("first", "second")]
    assert given[0] == given[1]
    named = {*given[0], *re.findall(r"DEITALK_\w+(?==)", text)}
    known = {f"DEITALK_{name.upper()}" for name in Settings.model_fields}
    assert len(named) >= 4 and named <= known


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("data", "{folder}/file/below", "Not a directory"),
        ("database", "sqlite:///{folder}/none/jobs.sqlite", "unable to open database file"),
        ("database", "postgresql+psycopg://me:secret@127.0.0.1:9/jobs", "Connection refused"),
        ("storage", "{folder}/file/below", "Not a directory"),
        ("storage", "smoke://signals", "Protocol not known: smoke"),
    ],
)
def test_places_of_jobs_that_cannot_be_used_are_named_in_one_line(tmp_path, name, value, says):
    pytest.importorskip("psycopg")
    (tmp_path / "file").touch()
    given = {"data": str(tmp_path / "data"), name: value.format(folder=tmp_path)}
    with pytest.raises(ConfigError) as caught:
        check_places(load_settings(**given))
    message = str(caught.value)
    assert message.startswith(f"{name} = ") and says in message and "secret" not in message
    assert message.count("\n") == 0 and message.endswith(f"(DEITALK_{name.upper()})")


def test_places_of_jobs_that_can_be_used_are_left_as_they_are(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "mine.txt").touch()
    check_places(load_settings(data=tmp_path / "data"))
    check_places(load_settings(data=tmp_path / "data"))
    names = {path.name for path in (tmp_path / "data").rglob("*")}
    assert names == {"mine.txt", "jobs.sqlite", "files"}


@pytest.fixture
def listening():
    """Port on which a program listens."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        yield taken.getsockname()[1]


class Part:
    is_ready = False


class Parts:
    pool, voices = Part(), Part()


def test_studio_is_opened_once_when_the_service_is_ready(monkeypatch):
    opened = queue.SimpleQueue()
    monkeypatch.setattr(serving.webbrowser, "open", opened.put)
    service = Parts()
    server = serving.Server(uvicorn.Config(lambda *_: None), service, "http://127.0.0.1:9/")

    def tick():
        asyncio.run(server.on_tick(1))

    tick()
    service.pool.is_ready = True
    tick()
    assert opened.empty() and server.studio
    service.voices.is_ready = True
    tick()
    tick()
    assert opened.get(timeout=300) == "http://127.0.0.1:9/" and opened.empty()


def test_studio_prints_what_was_given_alone(tmp_path, capsys):
    settings = load_settings(port=9000, data=str(tmp_path))
    serving.print_settings(settings, "http://127.0.0.1:9000/")
    first, *lines = capsys.readouterr().err.splitlines()
    assert first.endswith("studio at http://127.0.0.1:9000/; Ctrl-C ends it")
    assert sorted(lines) == [f"  data = {tmp_path}", "  port = 9000"]
    serving.print_settings(settings)
    assert len(capsys.readouterr().err.splitlines()) == 1 + len(Settings.model_fields)


def test_studio_refuses_a_port_on_which_something_listens(listening, monkeypatch):
    needs_player()
    opened = []
    monkeypatch.setattr(serving.webbrowser, "open", opened.append)
    with pytest.raises(ConfigError, match=f"port {listening} is taken"):
        commands.serve(None, port=listening, opens=True)
    assert not opened


def test_every_route_has_a_line_of_curl_in_the_documentation(tmp_path):
    """Each line has a path and a method of the schema, and each path of the schema has a line."""
    lines = re.findall(
        r"^curl .*$", (Path(api.__file__).parents[1] / "docs/service.md").read_text(), re.MULTILINE
    )
    found = set()
    for line in lines:
        path = re.search(r"http://127\.0\.0\.1:8000(/[^\s'?]*)", line).group(1)
        path = path.replace("$ID", "{job_id}").replace("metahuman-185@mh4", "{control_set}")
        sends = re.search(r" -F | --data-binary ", line)
        method = re.search(r"-X (\w+)", line)
        found.add((method.group(1) if method else "POST" if sends else "GET", path))
    schema = create_app(Settings(data=tmp_path)).openapi()["paths"]
    assert found == {(method.upper(), path) for path in schema for method in schema[path]}


def test_every_setting_has_a_row_in_the_documentation():
    text = (Path(api.__file__).parents[1] / "docs/service.md").read_text()
    rows = text[text.index("| setting | default | |") :].split("\n\n")[0]
    named = {
        name for row in rows.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])
    }
    assert named == set(Settings.model_fields)


def test_container_is_built_with_every_folder_that_the_package_needs():
    """The packages, and what the build hook takes from elsewhere; the context holds no other."""
    root = Path(api.__file__).parents[1]
    file = (root / "api/container/Dockerfile").read_text()
    copied = {name for line in re.findall(r"^COPY (?!--from)(.*) \S+$", file, re.MULTILINE)
              for name in line.split()}  # fmt: skip
    hook = (root / "deitalk/preview/web/hatch_build.py").read_text()
    sample = Path(re.search(r'^SAMPLE = "(.*)"$', hook, re.MULTILINE).group(1))
    project = tomllib.loads((root / "pyproject.toml").read_text())
    needed = {"pyproject.toml", "README.md", "LICENSE", str(sample.parent)}
    assert copied == needed | set(project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"])
    ignored = (root / "api/container/Dockerfile.dockerignore").read_text().splitlines()
    assert {line[1:] for line in ignored if line.startswith("!")} == copied
    assert all((root / name).exists() for name in copied)


def test_manifests_of_kubernetes_name_settings_and_probes_that_exist(tmp_path):
    """And the pod is given time for the steps in which a server ends."""
    text = (Path(api.__file__).parent / "container/kubernetes.yaml").read_text()
    pods = {each["kind"]: each for each in yaml.safe_load_all(text)}
    pod = pods["Deployment"]["spec"]["template"]
    (container,) = pod["spec"]["containers"]
    given = {
        entry["name"].removeprefix("DEITALK_").lower(): entry["value"] for entry in container["env"]
    }
    given = {n: json.loads(v) if v.startswith("[") else v for n, v in given.items()}
    keys = [{"name": "farm", "sha256": digest_of("dk_x")}]
    settings = Settings(data=tmp_path, keys=keys, **given)
    settings.check()
    assert container["ports"] == [{"name": "http", "containerPort": settings.port}]
    grace = settings.drain_notice_seconds + settings.drain_seconds
    assert pod["spec"]["terminationGracePeriodSeconds"] > grace + 5
    probes = {
        container[f"{kind}Probe"]["httpGet"]["path"]
        for kind in ("startup", "readiness", "liveness")
    }
    assert probes <= set(create_app(settings).openapi()["paths"])
    labels = pod["metadata"]["labels"]
    assert pods["Service"]["spec"]["selector"] == labels
    assert pods["HorizontalPodAutoscaler"]["spec"]["scaleTargetRef"]["name"] == "deitalk"
