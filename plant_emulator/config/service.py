"""Everything that the plant's side is configured by, assembled from its three files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from foundation.configuration import Host, HostName, StrictModel, load
from foundation.rest.tokens import TokenSources
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.scene import SceneConfig


class Endpoint(StrictModel):
    """Where a TCP server listens. Port 0 lets the system choose; the ready line names the choice."""

    host: Host
    port: int = Field(ge=0, le=65535)


class FaultApiConfig(Endpoint):
    """Where the emulator's HTTP face listens, whether it may break anything, and how it may be called.

    ``shows_truth``: it tells where the arm really is. ``allowed_hosts``: names beside loopback and ``host``;
    ``allowed_origins``: of pages from elsewhere that may ask, such as ``http://127.0.0.1:8000``. ``tokens``:
    who may look, who may operate; compulsory where ``host`` is not loopback.
    """

    allowed: bool
    shows_truth: bool = False
    allowed_hosts: tuple[HostName, ...] = ()
    allowed_origins: tuple[str, ...] = ()
    tokens: TokenSources = TokenSources()


class PlantServiceConfig(StrictModel):
    """``plant_service.yaml``: what the emulator's process does beside physics."""

    modbus: Endpoint
    camera_stream: Endpoint
    fault_face: FaultApiConfig
    period_ms: float = Field(gt=0.1, le=20.0)
    truth_hz: float = Field(ge=50.0, le=1000.0)
    fifo_priority: int = Field(ge=0, le=99)
    writer_release_ms: float = Field(ge=10.0, le=60_000.0)


class PlantSideConfig(NamedTuple):
    """The arm, the visible world, and the service."""

    plant: PlantConfig
    scene: SceneConfig
    service: PlantServiceConfig


def load_plant_side(config_dir: Path, overrides: Mapping[str, Mapping[str, Any]]) -> PlantSideConfig:
    """The plant's three files in a directory, with overrides by file stem laid over them.

    Overrides of files that other services read are left to them. Raises ConfigurationError for the first
    fault.
    """
    return PlantSideConfig(
        plant=load(PlantConfig, config_dir / "plant.yaml", overrides.get("plant")),
        scene=load(SceneConfig, config_dir / "scene.yaml", overrides.get("scene")),
        service=load(PlantServiceConfig, config_dir / "plant_service.yaml", overrides.get("plant_service")),
    )
