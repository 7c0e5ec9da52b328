"""What the plant's recording costs: in the loop, in its thread, on the disk; its peer is the MCAP library's
own writer with the truth alone as JSON.
"""

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from foundation.configuration import load
from foundation.recording.messages import DirectRecording
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from plant_emulator.shell.scene_messages import drawing
from plant_emulator.shell.truth_recorder import TruthRecorder
from tests.plant_emulator.plant_world import Driver, plant_config
from tests.support.paths import CONFIGS

RATE_HZ = 60.0  # truths and captures as shipped, each with its frames
SECONDS = 20
PERIOD_NS = round(1e9 / RATE_HZ)


def cpu_us(work: Callable[[], object], count: int) -> float:
    """CPU microseconds of this process for each of ``count`` pieces of ``work``."""
    began_s = time.process_time()
    work()
    return 1e6 * (time.process_time() - began_s) / count


@pytest.mark.bench
def test_recording_costs_less_than_three_percent_of_a_core(tmp_path: Path) -> None:
    scene = load(SceneConfig, CONFIGS / "scene.yaml")
    plant = Plant(plant_config(), 1, Scene(scene).mounts)
    driver, moments = Driver(plant), []
    for _ in range(round(SECONDS * RATE_HZ)):
        driver.run(0.015, (0.2, 0.1, 0.0, 0.0, 0.0, 0.0))
        moments.append((plant.truth(), plant.links()))
    drawn = drawing(scene, plant.chain, 0)
    threaded = TruthRecorder(tmp_path / "thread.mcap", {}, drawn)
    direct = TruthRecorder(tmp_path / "truth.mcap", {}, drawn, made=DirectRecording)

    def record(recorder: TruthRecorder) -> None:
        for number, (truth, X_WL) in enumerate(moments):
            recorder.truth(truth, number * PERIOD_NS, X_WL)

    began_s = time.thread_time()
    record(threaded)
    loop_us = 1e6 * (time.thread_time() - began_s) / len(moments)
    threaded.close()
    links_us = cpu_us(lambda: [plant.links() for _ in range(1000)], 1000)
    ours_us = cpu_us(lambda: (record(direct), direct.close()), len(moments))
    peer_us = cpu_us(lambda: peer(tmp_path / "peer.mcap", [truth for truth, _ in moments]), len(moments))
    sizes = {name: (tmp_path / f"{name}.mcap").stat().st_size * 60e-6 / SECONDS for name in ("truth", "peer")}
    print(f"\nin the loop {loop_us:.1f} us a truth, and {links_us:.1f} us for the links")
    for name, us, file in (("ours, with frames", ours_us, "truth"), ("peer, truth alone", peer_us, "peer")):
        share = 1e-4 * us * RATE_HZ
        print(f"{name}: {us:.0f} us a truth, {share:.2f} % of a core, {sizes[file]:.1f} MB/min")
    assert ours_us < 2.0 * peer_us
    assert sizes["truth"] < 15.0
    assert loop_us < 0.2 * peer_us


def peer(path: Path, truths: list[PlantTruth]) -> None:
    """The truth as JSON by the MCAP library's writer, chunks of the same time."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/truth", "json", writer.register_schema("t", "jsonschema", b"{}"))
        for number, truth in enumerate(truths):
            said = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in truth._asdict().items()}
            writer.add_message(channel, number * PERIOD_NS, json.dumps(said).encode(), truth.time_ns)
            if number % 24 == 23:
                writer.flush()
        writer.finish()
