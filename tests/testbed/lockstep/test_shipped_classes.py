"""Lockstep runs the classes that ship: link, arm, eyes and feed; its clock and its sources differ."""

import inspect
import io
from functools import partial

import pytest

from foundation.event_log import EventLog
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.simulated_measurements import LockstepFrames, load_eye_model, simulated_sight
from testbed.scenarios.scenario import Settings, load_settings
from tests.support.paths import CONFIGS
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.camera_feed import CameraFeed
from vision_pc.application.eyes import FrameEyes
from vision_pc.application.link_arm import CarryingArm, LinkArm
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.shell import service
from vision_pc.shell.camera_eyes import open_eyes
from vision_pc.shell.cameras import CameraSource, open_camera
from vision_pc.shell.link.udp_endpoint import UdpEndpoint
from vision_pc.shell.monotonic_clock import MonotonicClock


@pytest.fixture(scope="module")
def settings() -> Settings:
    return load_settings(CONFIGS, {})


def methods(kind: type) -> set[str]:
    return {name for name, _ in inspect.getmembers(kind, inspect.isfunction) if name in vars(kind)}


def test_link_arm_and_eyes_are_of_the_service_s_own_classes(settings: Settings) -> None:
    rig = LockstepRig(settings, 1, RunLog())
    log = EventLog("vision_pc", io.StringIO())
    endpoint = UdpEndpoint(settings.vision.link, 0, log, MonotonicClock())
    opened = open_eyes(open_camera(settings.vision.camera), endpoint.link, settings.vision, log)
    opened.worker.close()
    log.close()
    assert type(rig.link) is type(endpoint.link) is ReferenceLink
    assert type(rig.eyes) is type(opened.eyes) is CameraEyes
    assert isinstance(rig.application.arm, CarryingArm)
    assert type(rig.application.arm.driven) is service.LinkArm is LinkArm


def test_simulated_measurements_go_through_the_same_looks_and_watches(settings: Settings) -> None:
    sight = partial(simulated_sight, model=load_eye_model(CONFIGS), seed=1)
    rig = LockstepRig(settings, 1, RunLog(), sight)
    assert type(rig.eyes) is FrameEyes
    assert not methods(CameraEyes) & methods(FrameEyes) - {"__init__"}, (
        "camera eyes add to eyes and replace nothing"
    )


def test_one_feed_judges_frames_in_both_and_only_the_waiting_differs() -> None:
    assert methods(CameraSource) & methods(CameraFeed) == {"__init__"}
    assert methods(LockstepFrames) & methods(CameraFeed) == {"__init__", "frame_after", "status"}
