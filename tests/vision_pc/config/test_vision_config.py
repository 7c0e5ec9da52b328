"""What vision.yaml refuses."""

import pytest

from foundation.configuration import load
from protocol.errors import ConfigurationError
from tests.vision_pc.conftest import VISION_YAML
from vision_pc.config.vision import VisionConfig


def test_a_rectangle_inside_out_is_refused() -> None:
    wrong = {"markers": {"tool": {"carried_m": [[-0.1, 0.0, 0.1, 0.2], [0.1, 0.0, -0.1, 0.2]]}}}
    with pytest.raises(ConfigurationError, match=r"carried_m\.1.*each minimum below its maximum"):
        load(VisionConfig, VISION_YAML, wrong)
