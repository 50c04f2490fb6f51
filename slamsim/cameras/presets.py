"""Cameras that there are. Numbers are those of their data sheets; what these do not tell is a
typical value and says so.

The readout of rolling shutters stands in none: nearly all of the frame period is usual for small
sensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any, Literal

PresetName = Literal[
    "realsense_d435", "realsense_d455", "oak_d", "webcam_rolling", "fisheye_stereo"
]

# OmniVision OV9282: 1280 x 800 pixels of 3 um, global shutter (product brief). The full well and
# the read noise of pixels of that size are typical values (EMVA data of comparable sensors).
_GLOBAL_3UM = {
    "full_well_e": 8000.0,
    "read_noise_e": 4.0,
    "adc_bits": 10,
    "response": "linear",
    "vignetting": 0.25,
    "electrons_per_s": 1.2e6,
}
# Colour sensors with pixels of 1.4 to 1.55 um (OV2740 of the D435, IMX378 of the OAK-D): typical.
_SMALL_PIXELS = {
    "full_well_e": 5000.0,
    "read_noise_e": 2.5,
    "adc_bits": 10,
    "response": "srgb",
    "vignetting": 0.3,
    "electrons_per_s": 6e5,
}


def _grey(
    kind: str, lens: Mapping[str, Any], left_m: float = 0.0, stereo_left: str = ""
) -> dict[str, Any]:
    exposure = {"exposure_max_s": 0.02}
    return {
        **{"kind": kind, "lens": dict(lens), "offset": {"y_m": left_m}, "exposure": exposure},
        **{"sensor": dict(_GLOBAL_3UM), "jpeg_quality": 95, "stereo_left": stereo_left},
    }


def _depth(lens: Mapping[str, Any], baseline_m: float) -> dict[str, Any]:
    """The least depth follows from the search for disparity."""
    errors = {"baseline_m": baseline_m, "aligned_to": "color"}
    return {"kind": "depth", "lens": dict(lens), "depth": errors, "encoding": "png"}


def _color(lens: Mapping[str, Any], left_m: float, readout_s: float) -> dict[str, Any]:
    return {
        **{"kind": "color", "lens": dict(lens), "offset": {"y_m": left_m}},
        **{"readout_s": readout_s, "sensor": dict(_SMALL_PIXELS)},
    }


# Intel RealSense Product Family D400 Series data sheet (337029-009): at 4:3 the field of view of
# the D435's depth is 75 x 62 degrees (87 x 58 at 16:9), of its colour 69 x 42 at 16:9 (rolling
# shutter), baseline 50 mm, range to some 10 m. The colour lens
# is 15 mm to the left of the left imager (realsense2_description); the projector is put midway.
_D435_STEREO = {"width": 640, "height": 480, "horizontal_fov_deg": 75.0}
_D435_COLOR = {"width": 848, "height": 480, "horizontal_fov_deg": 69.0}
_D435 = {
    "rate_hz": 30.0,
    "projector": {"offset": {"y_m": -0.025}},
    "imagers": {
        "color": _color(_D435_COLOR, 0.015, 0.03),
        "depth": _depth(_D435_STEREO, 0.05),
        "infra1": _grey("infrared", _D435_STEREO),
        "infra2": _grey("infrared", _D435_STEREO, -0.05, "infra1"),
    },
}

# The same data sheet: D455, baseline 95 mm, colour 90 x 65 degrees at 16:10 with a global shutter
# (OV9782). The colour lens is 59 mm to the right of the left
# imager (realsense2_description).
_D455_STEREO = {"width": 848, "height": 480, "horizontal_fov_deg": 87.0}
_D455_COLOR = {"width": 640, "height": 400, "horizontal_fov_deg": 90.0}
_D455 = {
    "rate_hz": 30.0,
    "projector": {"offset": {"y_m": -0.0475}},
    "imagers": {
        "color": {
            **_color(_D455_COLOR, -0.059, 0.0),
            "sensor": {**_GLOBAL_3UM, "response": "srgb"},
        },
        "depth": _depth(_D455_STEREO, 0.095),
        "infra1": _grey("infrared", _D455_STEREO),
        "infra2": _grey("infrared", _D455_STEREO, -0.095, "infra1"),
    },
}

# OAK-D specification sheet (Luxonis): stereo OV9282, 80 x 55 degrees, global shutter, 7.5 cm
# apart; colour IMX378, 69 x 55 degrees, rolling shutter, between them. No projector. Depth is that
# of the left imager.
_OAK_STEREO = {"width": 640, "height": 400, "horizontal_fov_deg": 80.0}
_OAK_COLOR = {"width": 640, "height": 480, "horizontal_fov_deg": 69.0}
_OAK_D = {
    "rate_hz": 30.0,
    "imagers": {
        "color": _color(_OAK_COLOR, 0.0, 0.02),
        "left": _grey("grey", _OAK_STEREO, 0.0375),
        "right": _grey("grey", _OAK_STEREO, -0.0375, "left"),
        "depth": {**_depth(_OAK_STEREO, 0.075), "offset": {"y_m": 0.0375}},
    },
}

# Logitech C920: diagonal field of view 78 degrees (data sheet), which is 70.4 across at 16:9; a
# rolling shutter as above. Its barrel distortion is a typical one of calibrations.
_WEBCAM = {
    "rate_hz": 30.0,
    "imagers": {
        "color": {
            **_color(
                {
                    **{"width": 640, "height": 360, "horizontal_fov_deg": 70.4},
                    "distortion": [0.08, -0.16, 0.0005, -0.0005, 0.06],
                },
                0.0,
                0.03,
            ),
            "exposure": {"exposure_max_s": 0.03, "lag_s": 0.5},
        }
    },
}

# Intel RealSense T265 data sheet (572522): two OV9282 behind fisheye lenses of 163 (+-5) degrees,
# 848 x 800 pixels, 64 mm apart, 30 Hz, global shutter. Focal length and Kannala-Brandt coefficients
# are those that its factory calibrations have, near enough.
_FISHEYE = {
    **{"width": 848, "height": 800, "distortion_model": "equidistant"},
    **{"focal_px": [286.0, 286.0], "distortion": [-0.007, 0.045, -0.042, 0.008]},
}
_FISHEYE_STEREO = {
    "rate_hz": 30.0,
    "imagers": {
        "fisheye1": _grey("grey", _FISHEYE, 0.032),
        "fisheye2": _grey("grey", _FISHEYE, -0.032, "fisheye1"),
    },
}

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "realsense_d435": _D435,
    "realsense_d455": _D455,
    "oak_d": _OAK_D,
    "webcam_rolling": _WEBCAM,
    "fisheye_stereo": _FISHEYE_STEREO,
}


def with_preset(given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings over those of the preset that they name."""
    return _over(PRESETS[given["preset"]], given)


def _over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Both, where they differ that above; lists are taken as a whole."""
    merged = {key: deepcopy(value) for key, value in below.items()}
    for key, value in above.items():
        under = merged.get(key)
        if isinstance(under, Mapping) and isinstance(value, Mapping):
            merged[key] = _over(under, value)
        else:
            merged[key] = value
    return merged
