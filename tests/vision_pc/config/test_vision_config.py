"""vision.yaml holds no number of the arm's dimensions: the one place is arm.yaml."""

from typing import Any

import pytest

from foundation.configuration import load, parse_overrides
from protocol.errors import ConfigurationError
from tests.vision_pc.conftest import VISION_YAML
from vision_pc.config.vision import VisionConfig


@pytest.mark.parametrize(
    "assignment",
    [
        "vision.programs.local_map.arm={boom_m: 1.6}",
        "vision.hand_eye.arm.links=[]",
        "vision.hand_eye.wrist_to_tool_m=0.35",
    ],
)
def test_a_key_that_moved_to_arm_yaml_is_refused_and_says_so(assignment: str) -> None:
    overrides: dict[str, Any] = parse_overrides([assignment])["vision"]
    key = assignment.partition("=")[0].removeprefix("vision.")
    with pytest.raises(ConfigurationError, match=rf"vision\.yaml: {key}: .*arm\.yaml") as refused:
        load(VisionConfig, VISION_YAML, overrides)
    assert refused.value.cause == "configuration.unknown_key"


def test_a_rectangle_inside_out_is_refused() -> None:
    wrong = {"markers": {"tool": {"carried_m": [[-0.1, 0.0, 0.1, 0.2], [0.1, 0.0, -0.1, 0.2]]}}}
    with pytest.raises(ConfigurationError, match=r"carried_m\.1.*each minimum below its maximum"):
        load(VisionConfig, VISION_YAML, wrong)
