"""Settings of the service: defaults, a YAML file, the environment (``DEITALK_…``), in this order.

A later one replaces an earlier one. Lists and mappings in the environment are JSON.
"""

import os
import sys
from importlib.util import find_spec
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError

from deitalk.config.hub import is_hub_name
from deitalk.config.section import Pattern, rule
from deitalk.config.yaml_files import read_yaml
from deitalk.errors import ConfigError, DeitalkError
from deitalk.models.device import check_device
from deitalk.models.folder import embedded_models, model_folder
from deitalk.models.load import Backend
from rig.errors import quoted
from rig.limits import MIB, SECONDS

PREFIX = "DEITALK_"
FILE_VARIABLE = "DEITALK_SETTINGS"
OTHER_VARIABLES = ("DEITALK_CACHE", FILE_VARIABLE)
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
Scope = Literal["animate", "jobs", "live", "metrics"]
SCOPES: tuple[Scope, ...] = ("animate", "jobs", "live", "metrics")


class ApiKey(BaseModel):
    """One key that may call the service; the key itself is not stored."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[
        str, Pattern(r"[A-Za-z0-9_.-]{1,40}", "1 to 40 of A to Z, a to z, 0 to 9, _ . -")
    ]
    sha256: Annotated[str, Pattern(r"[0-9a-f]{64}", "64 of 0 to 9, a to f")] = Field(repr=False)
    scopes: tuple[Scope, ...] = SCOPES
    requests_per_minute: int = Field(default=600, ge=1, le=1_000_000)
    jobs: int = Field(default=100, ge=0, le=100_000)
    concurrent: int = Field(default=16, ge=1, le=10_000)
    live: int = Field(default=2, ge=0, le=1000)
    share: float = Field(default=1.0, ge=0.01, le=100)
    audio_seconds_per_hour: int = Field(default=0, ge=0, le=10_000_000)
    keep_mb: int | None = Field(default=None, ge=1, le=100_000_000)


class Settings(BaseSettings):
    """All settings; every field is described in ``docs/service.md``."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, extra="forbid", frozen=True)

    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    grpc_port: int = Field(default=0, ge=0, le=65535)
    data: Path = Field(default_factory=lambda: _data_folder())
    database: str = ""
    storage: str = ""
    keys: tuple[ApiKey, ...] = ()
    hosts: tuple[str, ...] = ()
    proxies: tuple[str, ...] = ()
    origins: tuple[str, ...] = ()

    models: dict[str, Path] = {}
    preload: tuple[str, ...] = ("default",)
    device: str = "cpu"
    backend: Literal["torch", "onnx"] = "torch"
    live_backend: Backend = "auto"
    workers: int = Field(default_factory=lambda: min(os.cpu_count() or 1, 4), ge=1, le=64)
    job_workers: int = Field(default=1, ge=0, le=64)
    memory_mb: int = Field(default=4096, ge=256, le=1_000_000)
    work_seconds: float = Field(default=120, gt=0, le=86_400)
    job_work_seconds: float = Field(default=6 * 3600, gt=0, le=7 * 86_400)

    max_bytes: int = Field(default=256 * MIB, ge=1024, le=2048 * MIB)
    max_seconds: float = Field(default=60, gt=0, le=600)
    max_job_seconds: float = Field(default=SECONDS, gt=0, le=SECONDS)
    max_channels: int = Field(default=16, ge=1, le=64)
    max_pixels: float = Field(default=5e9, ge=1e6, le=1e12)
    waiting: int = Field(default=64, ge=0, le=10_000)
    queued_jobs: int = Field(default=1000, ge=1, le=1_000_000)
    requests_per_minute: int = Field(default=1200, ge=1, le=1_000_000)
    connections: int = Field(default=256, ge=1, le=65_536)
    header_seconds: float = Field(default=10, gt=0, le=600)
    body_seconds: float = Field(default=60, gt=0, le=3600)
    live_sessions: int = Field(default=16, ge=0, le=1000)
    live_workers: int = Field(default_factory=lambda: min(os.cpu_count() or 1, 4), ge=1, le=64)
    live_seconds: float = Field(default=3600, gt=0, le=86_400)
    drain_notice_seconds: float = Field(default=0, ge=0, le=600)
    drain_seconds: float = Field(default=30, ge=0, le=86_400)
    log: Literal["text", "json"] = "text"

    job_attempts: int = Field(default=5, ge=1, le=20)
    lease_seconds: float = Field(default=10, ge=0.2, le=600)
    keep_days: float = Field(default=7, gt=0, le=3650)
    keep_mb: int = Field(default=10_240, ge=1, le=100_000_000)

    @field_validator("models")
    @classmethod
    def _named(cls, models: dict[str, Path]) -> dict[str, Path]:
        for name in models:
            if not name.replace("_", "").replace("-", "").isalnum() or name in embedded_models():
                raise ValueError(
                    f"{quoted(name)} must be letters, digits, - and _, and no embedded model"
                )
        return {
            name: model_folder(path) if is_hub_name(path) else path.absolute()
            for name, path in models.items()
        }

    @field_validator("device")
    @classmethod
    def _is_device(cls, name: str) -> str:
        try:
            return check_device(name)
        except DeitalkError as error:
            raise ValueError(str(error)) from None

    @field_validator("database")
    @classmethod
    def _is_url(cls, url: str) -> str:
        try:
            make_url(url or "sqlite://")
        except ArgumentError:
            raise ValueError("it must be a SQLAlchemy URL such as postgresql+psycopg://…") from None
        return url

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach the service."""
        return is_loopback(self.host)

    @property
    def database_url(self) -> str:
        """SQLAlchemy URL of the jobs; SQLite in `data` by default."""
        return self.database or f"sqlite:///{self.data / 'jobs.sqlite'}"

    @property
    def storage_url(self) -> str:
        """The fsspec URL of recordings and results of jobs; a folder in `data` by default."""
        return self.storage or str(self.data / "files")

    @property
    def known_models(self) -> dict[str, Path | str]:
        """Every model that a request may name: the embedded ones and `models`."""
        return {name: name for name in embedded_models()} | dict(self.models)

    def check(self) -> None:
        """Refuse settings that would open the service to a network without keys.

        Raises
        ------
        ConfigError
            If the host is no loopback address and there are no keys, or `preload` names a model
            that is unknown.
        """
        if not self.is_local and not self.keys:
            raise ConfigError(
                f"host {self.host} can be reached from other machines, and there are no keys; make "
                "one with `deitalk serve key NAME`, or serve on 127.0.0.1"
            )
        if self.backend == "onnx" and self.device != "cpu":
            raise ConfigError(
                f"device {quoted(self.device)}: backend onnx runs on cpu only; leave device out"
            )
        if "onnx" in (self.backend, self.live_backend) and find_spec("onnxruntime") is None:
            raise ConfigError("backend onnx needs `pip install 'deitalk[onnx]'`")
        if self.grpc_port and find_spec("nvidia_audio2face_3d") is None:
            raise ConfigError("grpc_port needs `pip install 'deitalk[audio2face]'`")
        unknown = [name for name in self.preload if name not in self.known_models]
        if unknown:
            raise ConfigError(
                f"preload names {quoted(unknown[0])}; known models: {', '.join(self.known_models)}"
            )

    @property
    def backend_of_live(self) -> Backend:
        """Backend of live sessions; ``auto`` is as for `deitalk.models.load.load_network`."""
        return (
            "onnx" if (self.live_backend, self.backend) == ("auto", "onnx") else self.live_backend
        )

    @property
    def shown(self) -> dict[str, str]:
        """Every setting as text, without secrets."""
        values = {name: getattr(self, name) for name in Settings.model_fields} | {
            "keys": ", ".join(key.name for key in self.keys) or "none",
            "database": make_url(self.database_url).render_as_string(hide_password=True),
            "storage": self.storage_url.rpartition("@")[2],
        }
        return {
            name: (", ".join(map(str, value)) or "none")
            if isinstance(value, dict | tuple)
            else str(value)
            for name, value in values.items()
        }

    def lines(self) -> list[str]:
        """Return one line ``name = value`` for each setting, without secrets."""
        return [f"{name} = {value}" for name, value in self.shown.items()]


def load_settings(file: Path | None = None, **given: Any) -> Settings:
    """Read the settings.

    Parameters
    ----------
    file : Path, optional
        YAML; by default the one that ``$DEITALK_SETTINGS`` names, if any.
    **given
        Settings that replace those of file and environment; None is left out.

    Raises
    ------
    ConfigError
        If a name is unknown or a value out of its range.
    """
    named = os.environ.get(FILE_VARIABLE)
    path = file if file is not None else Path(named) if named else None
    content = {} if path is None else read_yaml(path) or {}
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: settings are lines such as `port: 8000`")
    known = {PREFIX + name.upper() for name in Settings.model_fields} | {*OTHER_VARIABLES}
    for name in os.environ:
        if name.upper().startswith(PREFIX) and name.upper() not in known:
            raise ConfigError(f"variable {quoted(name)} is no setting; see docs/service.md")

    class FromFile(Settings):
        @classmethod
        def settings_customise_sources(
            cls,
            settings_cls: type[BaseSettings],
            init_settings: PydanticBaseSettingsSource,
            env_settings: PydanticBaseSettingsSource,
            dotenv_settings: PydanticBaseSettingsSource,
            file_secret_settings: PydanticBaseSettingsSource,
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            return init_settings, env_settings, _Fixed(settings_cls, content)

    try:
        return FromFile(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        name = ".".join(map(str, first["loc"]))
        raise ConfigError(
            f"setting {quoted(name)}: {rule(first, Settings)}; see docs/service.md"
        ) from None
    except ValueError as error:  # JSON in the environment
        raise ConfigError(f"settings: {error}; lists and mappings are JSON") from None


def is_loopback(host: str) -> bool:
    """Whether an address or name is this machine's own."""
    if host in LOOPBACK_NAMES:
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


class _Fixed(PydanticBaseSettingsSource):
    """Values of the settings file."""

    def __init__(self, settings_cls: type[BaseSettings], values: dict[str, Any]) -> None:
        super().__init__(settings_cls)
        self.values = values

    def get_field_value(self, field: Any, field_name: str) -> tuple[Any, str, bool]:
        return self.values.get(field_name), field_name, False

    def __call__(self) -> dict[str, Any]:
        return self.values


def _data_folder() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "deitalk-service"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Application Support" / "deitalk-service"
    share = os.environ.get("XDG_DATA_HOME", Path.home() / ".local" / "share")
    return Path(share) / "deitalk-service"
