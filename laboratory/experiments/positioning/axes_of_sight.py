"""What differs from one camera, scene and set of markers to the next, each as an axis (see ``axes``)."""

import numpy as np

from laboratory.experiments.positioning.axes import JSON, axis, between, factor, values
from testbed.scenarios.scenario import Settings

# ---- the camera


# What the maker's calibration leaves.
rectification = values(
    "rectification",
    "disparity ±3.5 px, rows ±1 px",
    "[S] zed-sdk 44: a ZED from the factory showed 25 m as 12 m: 3.5 px; [E] rows",
    "scene.camera.rectification",
    disparity_px=between(-3.5, 3.5),
    vertical_px=between(-1.0, 1.0),
)


@axis("baseline ±0.6 %, focal length ±0.3 %, k1 ±0.006", "[S] the study's scale of ±0.6 %; [E] the lens")
def lens(rng: np.random.Generator, _usual: Settings) -> JSON:
    """Scale and residual distortion, alike in both eyes."""
    focal = 530.0 * (1.0 + rng.uniform(-0.003, 0.003))
    drawn = {
        "baseline_m": 0.12 * (1.0 + rng.uniform(-0.006, 0.006)),
        "lens": {"fx_px": focal, "fy_px": focal, "k1": rng.uniform(-0.006, 0.006)},
    }
    return {"scene": {"camera": drawn}}


@axis("0.7 px each way, one σ", "[E] what factory calibrations leave")
def principal_point(rng: np.random.Generator, usual: Settings) -> JSON:
    """Where both principal points are, beside the middle of the picture, where the calibration has them."""
    camera, off = usual.scene.camera, rng.normal(0.0, 0.7, 2)
    drawn = {"cx_px": 0.5 * (camera.width_px - 1) + off[0], "cy_px": 0.5 * (camera.height_px - 1) + off[1]}
    return {"scene": {"camera": {"lens": drawn}}}


@axis(
    "noise 2 to 5 grey levels, blur 0.5 to 1.0 px, exposure ×0.6 to 1.6, contrast 10 to 25",
    "[E] of a ZED 2 in a hall and outdoors",
)
def light(rng: np.random.Generator, _usual: Settings) -> JSON:
    """What light and focus make of pictures; without pictures, the eye model's condition stands for it."""
    camera = {
        "noise_grey": rng.uniform(2.0, 5.0),
        "blur_px": rng.uniform(0.5, 1.0),
        "exposure_gain": factor(rng, 1.6),
    }
    return {"scene": {"camera": camera, "wall": {"contrast_grey": rng.uniform(10.0, 25.0)}}}


# The ZED 2's readout.
rolling_shutter = values(
    "rolling_shutter",
    "15.7 µs a row, 11.3 ms in all; not drawn",
    "[S] Stereolabs support: the ZED 2 at 720p and 60 Hz",
    "scene.camera.shutter",
    kind="rolling",
    mode_hz=60,
)


# How far the wall rises and falls about its plane.
uneven_wall = values(
    "uneven_wall",
    "0 to 8 mm over 0.5 to 2 m",
    "[E] shotcrete and rough concrete",
    "scene.wall",
    undulation_mm=between(0.0, 8.0),
    undulation_length_m=between(0.5, 2.0),
)


# What the right eye's lens has more than the left's.
two_lenses = values(
    "two_lenses",
    "focal lengths ±0.3 px, k1 ±0.0015, k2 ±0.0005, p1 and p2 ±0.0002, right eye against left",
    "[E] two eyes rectified one by one",
    "scene.camera.lens_difference",
    fx_px=between(-0.3, 0.3),
    fy_px=between(-0.3, 0.3),
    k1=between(-0.0015, 0.0015),
    k2=between(-0.0005, 0.0005),
    p1=between(-0.0002, 0.0002),
    p2=between(-0.0002, 0.0002),
)


# How the rectification wanders as the camera warms.
drift = values(
    "drift",
    "disparity 0.05 to 0.3 px, rows 0.05 to 0.2 px rms, within 5 to 15 minutes",
    "[E] heat moves low-cost stereo cameras by a few parts in a thousand of a pixel a second",
    "scene.camera.drift",
    disparity_px=between(0.05, 0.3),
    vertical_px=between(0.05, 0.2),
    time_constant_s=between(300.0, 900.0),
)


# What is wrong with the times of pictures.
stamps = values(
    "stamps",
    "−10 to 20 ms late, jitter 0.5 to 3 ms rms",
    "[E] a camera stamped by a host that is not real-time",
    "scene.camera.stamps",
    delay_ms=between(-10.0, 20.0),
    jitter_ms=between(0.5, 3.0),
)


# ---- light and surroundings


# What the camera makes of light by itself.
exposure = values(
    "exposure",
    "gamma 0.45 to 1",
    "[S] sRGB's curve is about 0.45",
    "scene.camera",
    response_gamma=between(0.45, 1.0),
)


# The edge of a shade that wanders over the scene.
moving_shadow = values(
    "moving_shadow",
    "0.35 to 0.8 of the light left, 0.02 to 0.5 m/s, penumbra 5 to 60 mm, any direction",
    "[E] a boom, a person, a cloud's edge",
    "scene.lighting.shadow",
    factor=between(0.35, 0.8),
    direction_deg=between(-180.0, 180.0),
    start_m=between(-1.5, 0.0),
    speed_m_s=between(0.02, 0.5),
    penumbra_m=between(0.005, 0.06),
)


@axis(
    "2 to 4 blocks of 0.3 to 0.9 m that stand out by 30 to 200 mm, 1 to 3 patches of 0.15 to 0.5 m with "
    "0.05 to 0.4 of the contrast, beside the object",
    "[E] shotcrete, boulders, formwork",
)
def broken_wall(rng: np.random.Generator, _usual: Settings) -> JSON:
    """Depth steps and bare patches of the wall."""
    blocks, patches = [], []
    for number in range(rng.integers(2, 5)):
        size = rng.uniform(0.3, 0.9, 2)
        blocks.append(
            {
                "centre_m": _beside(rng, 0.5 * float(np.hypot(*size))),
                "size_m": size.tolist(),
                "depth_m": rng.uniform(0.03, 0.2),
                "texture_seed": number + 1,
            }
        )
    for _ in range(rng.integers(1, 4)):
        radius = rng.uniform(0.15, 0.5)
        patches.append(
            {"centre_m": _beside(rng, radius), "radius_m": radius, "contrast": rng.uniform(0.05, 0.4)}
        )
    return {"scene": {"wall": {"blocks": blocks, "bare_patches": patches}}}


_OBJECT_REACH_M = 0.34  # from the middle to the corner of the farthest marker's quiet zone, and a little


def _beside(rng: np.random.Generator, size_m: float) -> list[float]:
    """A centre (2,) on the wall from where something of that size leaves the object's markers free."""
    away = _OBJECT_REACH_M + size_m + rng.uniform(0.0, 0.8)
    towards = rng.uniform(0.0, 2.0 * np.pi)
    return [away * float(np.cos(towards)), away * float(np.sin(towards))]


@axis(
    "0.5 by 1.8 m, 0.5 to 1.5 m/s, every 15 to 60 s, 0.1 to 0.5 m before the wall, above or below the object",
    "[E] people and machines at work",
)
def passers(rng: np.random.Generator, _usual: Settings) -> JSON:
    """Something large that crosses, and hides no marker of the object."""
    side = rng.choice([-1.0, 1.0])
    way = rng.choice([-1.0, 1.0])
    height = side * (0.9 + _OBJECT_REACH_M + rng.uniform(0.0, 0.5))
    passer = {
        "start_m": [-3.0 * way, height, rng.uniform(0.1, 0.5)],
        "velocity_m_s": [way * rng.uniform(0.5, 1.5), 0.0, 0.0],
        "period_s": rng.uniform(15.0, 60.0),
    }
    return {"scene": {"passers": [passer]}}


# ---- the markers


# The printed size of the tool's marker.
tool_print = values(
    "tool_print",
    "±0.3 %",
    "[E] a copier's scale",
    "scene.tool_marker",
    print_scale_error=between(-0.003, 0.003),
)


@axis(
    "places ±1 mm, turned by up to 0.5°, prints ±0.3 %, plates bent by up to 0.5 mm",
    "[E] a tape measure, a hand, a copier, a sheet of plastic",
)
def object_markers(rng: np.random.Generator, usual: Settings) -> JSON:
    """Where the object's markers are, and how large."""
    drawn = []
    for marker in usual.scene.object_of_interest.markers:
        off: JSON = {
            "misplaced_m": rng.uniform(-0.001, 0.001, 3).tolist(),
            "misplaced_deg": rng.uniform(-0.3, 0.3, 3).tolist(),
            "print_scale_error": rng.uniform(-0.003, 0.003),
            "bend_m": rng.uniform(-0.0005, 0.0005),
            "bend_direction_deg": rng.uniform(-90.0, 90.0),
        }
        drawn.append(marker.model_dump(mode="json") | off)
    return {"scene": {"object_of_interest": {"markers": drawn}}}
