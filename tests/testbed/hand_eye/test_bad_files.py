"""A good file of samples spoiled, and what `hand-eye solve` answers to each."""

import copy
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from laboratory.experiments.hand_eye import scenes
from protocol.errors import LongreachError
from testbed.hand_eye.importer import FORMAT, load
from tests.support.commands import ran
from tests.testbed.hand_eye.test_hand_eye_files import saved
from vision_pc.config.choices import Method
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers import judgement
from vision_pc.core.se3 import Array

Document = dict[str, Any]
_NOISE = scenes.noise(0.2, 1.0)


class BadFile(NamedTuple):
    """A mistake: how it spoils a good file's ``Document`` (or its text), and the answer that it must get.

    ``cause`` of the refusal, or of the question where ``asked``; ``said`` is in its sentence.
    """

    name: str
    spoil: Callable[[Document], Document | str]
    cause: str
    said: str
    asked: bool = False


def good_file(samples: int, seed: int) -> Document:
    """A file of eye-in-hand samples, drawn: a target at 0.8 m, 0.2° and 1 mm of noise."""
    rng = np.random.default_rng(seed)
    pairs = scenes.measured(scenes.viewing_scene(rng, samples), _NOISE, rng)
    back = np.argsort(np.array(pairs.order))
    drawn = [
        {"name": f"s{k + 1}", "hand": pairs.X_BT[i].tolist(), "camera": pairs.P[i].tolist()}
        for k, i in enumerate(back)
    ]
    return {"format": FORMAT, "setup": "eye-in-hand", "length_unit": "m", "samples": drawn}


def _poses(good: Document, side: str) -> Array:
    return np.array([sample[side] for sample in good["samples"]])


def _with(side: str, change: Callable[[Array], Array]) -> Callable[[Document], Document]:
    def spoil(good: Document) -> Document:
        for sample, X in zip(good["samples"], change(_poses(good, side)), strict=True):
            sample[side] = X.tolist()
        return good

    return spoil


def _lengths(factor: float | Array) -> Callable[[Array], Array]:
    return lambda X: stacks.transform(X[:, :3, :3], factor * X[:, :3, 3])


def _half(X: Array) -> Array:
    return stacks.transform(X[:, :3, :3], stacks.inverse(X)[:, :3, 3])


def _shifted(good: Document) -> Document:
    cameras = [sample["camera"] for sample in good["samples"]]
    good["samples"] = good["samples"][:-1]
    for sample, camera in zip(good["samples"], cameras[1:], strict=True):
        sample["camera"] = camera
    return good


def _exchanged(good: Document) -> Document:
    for sample in good["samples"]:
        sample["hand"], sample["camera"] = sample["camera"], sample["hand"]
    return good


def _set(*path: Any, value: Any) -> Callable[[Document], Document]:
    def spoil(good: Document) -> Document:
        at: Any = good
        for key in path[:-1]:
            at = at[key]
        at[path[-1]] = value
        return good

    return spoil


def _unrelated(good: Document) -> Document:
    order = np.random.default_rng(0).permutation(len(good["samples"]))
    return _with("camera", lambda X: X[order])(good)


_LOW = np.array([1.0, 1.0, 1e-3])
_REFUSED, _FAILED = "refused.hand_eye.", "measurement.hand_eye."
_MISREAD, _SCALE, _FEW = _FAILED + "misread", _FAILED + "scale", _FAILED + "too_few_samples"
_HAND, _CAMERA = "hand", "camera"

BAD_FILES = (
    BadFile("cut off in the middle", lambda g: json.dumps(g)[:400], _REFUSED + "unreadable", "not JSON"),
    BadFile("no samples in it", _set("samples", value=[]), _FEW, "0 samples"),
    BadFile("two samples", lambda g: {**g, "samples": g["samples"][:2]}, _FEW, "at least 3"),
    BadFile("poses that do not belong together", _unrelated, _FAILED + "motions_differ", "belong"),
    BadFile("sides shifted by one", _shifted, _MISREAD, "shifted by one"),
    BadFile("the other setup", _set("setup", value="eye-to-hand"), _MISREAD, "the setup is eye-in-hand"),
    BadFile("camera half inverted", _with(_CAMERA, _half), _MISREAD, "camera positions are inverted and"),
    BadFile("hand half inverted", _with(_HAND, _half), _MISREAD, "hand positions are inverted and rotations"),
    BadFile("height in mm", _with(_HAND, _lengths(_LOW)), _FAILED + "noise", "rotations fit and positions"),
    BadFile("camera in m, taken for mm", _with(_CAMERA, _lengths(1e-3)), _SCALE, "in m beside a hand in mm"),
    BadFile("camera 25.4 times too small", _with(_CAMERA, _lengths(1.0 / 25.4)), _SCALE, "inches"),
    BadFile("square said 10 % too large", _with(_CAMERA, _lengths(1.1)), _SCALE, "another size"),
    BadFile("square said 2 % too small", _with(_CAMERA, _lengths(0.98)), _SCALE, "another size", asked=True),
    BadFile("hand and camera exchanged", _exchanged, _FAILED + "exchanged", "exchanged", asked=True),
)


@pytest.mark.parametrize("bad", BAD_FILES, ids=lambda bad: bad.name)
def test_a_bad_file_is_answered_rightly(bad: BadFile, tmp_path: Path) -> None:
    made = bad.spoil(copy.deepcopy(good_file(8, 1)))
    file = tmp_path / "samples.json"
    file.write_text(made if isinstance(made, str) else json.dumps(made), encoding="utf-8")
    if not bad.asked:
        with pytest.raises(LongreachError, match=re.escape(bad.said)) as refused:
            judgement.believed(load(file), Method.ROBUST)
        assert refused.value.cause == bad.cause
        return
    _, found = judgement.believed(load(file), Method.ROBUST)
    assert any(doubt.cause == bad.cause and bad.said in doubt.reason for doubt in found.doubts)


def test_the_good_file_they_are_made_of_is_good(tmp_path: Path) -> None:
    file = saved(tmp_path, good_file(8, 1))
    shown = ran("hand-eye", "solve", file, "--json", tmp_path / "x.json").output
    assert "verdict: good" in shown
    figures = json.loads((tmp_path / "x.json").read_text())
    assert " ".join(f"{1e3 * p:.3f}" for p in figures["X"]["p_m"]) in shown
    assert [len(figures["samples"]), figures["certificate"]["holds"]] == [8, True]
    verdict = figures["verdict"]
    assert verdict["word"] == "good"
    assert verdict["scale"]["factor"] == pytest.approx(1.0, abs=5.0 * verdict["scale"]["std"])
    assert verdict["next_best_noise_ratio"] > 5.0


def test_a_refused_file_gives_its_number_only_as_given(tmp_path: Path) -> None:
    good = good_file(8, 1)
    good["setup"] = "eye-to-hand"
    file = saved(tmp_path, good)
    assert "residuals" not in ran("hand-eye", "solve", file, status=2).output
    told = ran("hand-eye", "solve", file, "--as-given").output
    assert "verdict: refused" in told
    assert "residuals" in told


def test_a_questioned_file_gives_its_number_and_status_1(tmp_path: Path) -> None:
    """Camera lengths 3 % too long: a target measured a little wrongly."""
    good = good_file(40, 1)
    for sample in good["samples"]:
        for row in sample["camera"][:3]:
            row[3] *= 1.03
    file = saved(tmp_path, good)
    questioned = ran("hand-eye", "solve", file, status=1).output
    assert "verdict: questioned" in questioned
    assert "residuals" in questioned
    ran("hand-eye", "solve", file, "--as-given")
