"""Has Debian's Prometheus read three running services, and evaluates every expression of the dashboard.

``python -m testbed.dashboard.trial`` prints a line an expression; exit status 1 where one has no value that
should have one.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx

from foundation.command_options import shipped_configs
from testbed.dashboard.panels import dashboard, expressions_of
from testbed.realtime.launch import prepare
from testbed.realtime.rest_rig import RestRig
from testbed.realtime.supervisor import free_port, supervised
from testbed.reporting.console import bars

_SCRAPE_S, _READY_S, _RUN_S = 1, 60.0, 20.0
_QUIET = ("_failures_total", "_refused_total")  # tables that are empty while all is well


def main() -> int:
    """Exit status."""
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        launch = prepare(shipped_configs(), {}, Path(folder), any_ports=True, foxglove=0)
        config = Path(folder) / "prometheus.yml"
        target = f"{{targets: ['127.0.0.1:{launch.foxglove}']}}"
        job = f"{{job_name: longreach, static_configs: [{target}]}}"
        config.write_text(f"global: {{scrape_interval: {_SCRAPE_S}s}}\nscrape_configs: [{job}]\n")
        command = [
            "prometheus",
            f"--config.file={config}",
            f"--storage.tsdb.path={folder}/data",
            f"--web.listen-address=127.0.0.1:{port}",
            "--log.level=error",
        ]
        with supervised(launch.services, Path(folder)):
            process = subprocess.Popen(command)
            try:
                _work(launch.rest_url)
                time.sleep(_RUN_S)
                return _evaluated(f"http://127.0.0.1:{port}")
            finally:
                process.terminate()
                process.wait()


def _work(url: str) -> None:
    rig = RestRig(url)
    rig.wait_healthy(_READY_S)
    with bars() as shown, shown.step("looking") as bar:
        rig.result("look", {}, bar)
    rig.close()


def _evaluated(url: str) -> int:
    version = httpx.get(f"{url}/api/v1/status/buildinfo").json()["data"]["version"]
    (target,) = httpx.get(f"{url}/api/v1/targets").json()["data"]["activeTargets"]
    print(f"Prometheus {version}: {target['scrapeUrl']} is {target['health']} {target['lastError']}")
    without = 0
    every = expressions_of(dashboard())
    for expression in every:
        answer = httpx.get(f"{url}/api/v1/query", params={"query": expression}).json()
        values = [each["value"][1] for each in answer.get("data", {}).get("result", [])]
        empty = not values and not any(quiet in expression for quiet in _QUIET)
        without += empty or answer["status"] != "success"
        print(f"{answer['status']:8} {', '.join(values) or '-':40} {expression}")
    print(f"{len(every) - without} of {len(every)} expressions are answered")
    return 1 if without else 0


if __name__ == "__main__":
    sys.exit(main())
