"""Compiles every numba kernel once, into its cache: a part of set-up and of the image."""

import sys

from foundation.command_options import usual_configs
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.run_log import RunLog
from testbed.reporting.console import bars
from testbed.scenarios.settings import load_settings


def main() -> int:
    """Exit status 0; a short life of all services in lockstep: a look, a short track with odometry."""
    rig = LockstepRig(load_settings(usual_configs(), {}), 1, RunLog())
    rig.command("enable")
    with bars(quiet=True) as shown, shown.step("look") as bar:
        rig.operate("look", {"frames": 1}, bar)
        rig.operate("local-track", {"leg_m": 0.05}, bar)
    return 0


if __name__ == "__main__":
    sys.exit(main())
