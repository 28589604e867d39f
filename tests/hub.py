"""A Hugging Face hub of this machine: repositories in memory, behind the routes that clients use."""

import base64
import hashlib
import json
import re
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from urllib.parse import unquote, urlsplit

TOKEN = "hf_test"


class Hub:
    """Repositories by name, each a list of commits, each the files by path."""

    def __init__(self):
        self.repositories, self.objects, self.asked, self.private = {}, {}, [], {}
        self.is_up = True

    def commit(self, name, files):
        commits = self.repositories.setdefault(name, [])
        commits.append((commits[-1] if commits else {}) | files)
        return commit_id(name, len(commits))

    def files(self, name, revision):
        commits = self.repositories.get(name, [])
        ids = [commit_id(name, number + 1) for number in range(len(commits))]
        place = len(ids) - 1 if revision == "main" else ids.index(revision)
        return ids[place], commits[place]


def commit_id(name, number):
    return hashlib.sha1(f"{name} {number}".encode()).hexdigest()


@contextmanager
def serving():
    """A hub and its address."""
    hub = Hub()

    class Handler(_Handler):
        state = hub

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield hub, f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    state: Hub

    def log_message(self, *_):
        pass

    def answer(self, content, status=200, headers=None):
        data = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        for key, value in {"Content-Length": str(len(data)), **(headers or {})}.items():
            self.send_header(key, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def handle_any(self):
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        path = unquote(urlsplit(self.path).path)
        self.state.asked.append((self.command, path))
        try:
            if not self.state.is_up:
                self.answer({"error": "down"}, 503)
            elif self.command in ("POST", "PUT"):
                self.write(path, body)
            else:
                self.read(path)
        except (KeyError, ValueError, IndexError):
            headers = {"X-Error-Code": "RepoNotFound"}
            self.answer({"error": "not found"}, 404, headers)

    do_GET = do_HEAD = do_POST = do_PUT = handle_any

    def read(self, path):
        if found := re.fullmatch(r"/api/models/([^/]+/[^/]+)(?:/(revision|tree)/([^/]+))?", path):
            name, kind, revision = found.groups()
            sha, files = self.state.files(name, revision or "main")
            rows = [
                {"type": "file", "path": f, "size": len(d), "oid": ""} for f, d in files.items()
            ]
            siblings = [{"rfilename": file} for file in files]
            self.answer(rows if kind == "tree" else {"id": name, "sha": sha, "siblings": siblings})
        elif found := re.fullmatch(r"/([^/]+/[^/]+)/resolve/([^/]+)/(.+)", path):
            name, revision, file = found.groups()
            sha, files = self.state.files(name, revision)
            etag = hashlib.sha256(files[file]).hexdigest()
            self.answer(files[file], headers={"ETag": f'"{etag}"', "X-Repo-Commit": sha})
        else:
            raise KeyError(path)

    def write(self, path, body):
        if path.startswith("/objects/"):
            self.state.objects[path.removeprefix("/objects/")] = body
            return self.answer({})
        if self.headers.get("Authorization") != f"Bearer {TOKEN}":
            return self.answer({"error": "no token"}, 401)
        if path == "/api/repos/create":
            given = json.loads(body)
            name = f"{given['organization']}/{given['name']}"
            self.state.private[name] = given.get("private", given.get("visibility") == "private")
            return self.answer({"url": f"http://{self.headers['Host']}/{name}", "name": name})
        if path.endswith("/preupload/main"):
            files = [file["path"] for file in json.loads(body)["files"]]
            modes = {True: "lfs", False: "regular"}
            rows = [
                {
                    "path": file,
                    "uploadMode": modes[file.endswith(".safetensors")],
                    "shouldIgnore": False,
                }
                for file in files
            ]
            return self.answer({"files": rows})
        if path.endswith("/info/lfs/objects/batch"):
            rows = [
                {
                    **item,
                    "actions": {
                        "upload": {"href": f"http://{self.headers['Host']}/objects/{item['oid']}"}
                    },
                }
                for item in json.loads(body)["objects"]
            ]
            return self.answer({"transfer": "basic", "objects": rows})
        if found := re.fullmatch(r"/api/models/([^/]+/[^/]+)/commit/main", path):
            sha = self.state.commit(found[1], self.committed(body))
            url = f"http://{self.headers['Host']}/{found[1]}/commit/{sha}"
            return self.answer({"success": True, "commitOid": sha, "commitUrl": url})
        return self.answer({})

    def committed(self, body):
        files = {}
        for line in body.splitlines():
            row = json.loads(line)
            if row["key"] == "file":
                files[row["value"]["path"]] = base64.b64decode(row["value"]["content"])
            elif row["key"] == "lfsFile":
                files[row["value"]["path"]] = self.state.objects[row["value"]["oid"]]
        return files
