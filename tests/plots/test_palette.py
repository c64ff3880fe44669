"""Colours of series stay apart for every common form of colour vision, and visible on their paper."""

import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest

from split_cli.plots import palette
from split_cli.plots.palette import DARK, DOTS, LIGHT, PAPER

# Machado, Oliveira and Fernandes (2009), severity 1.0, on linear RGB.
VISION = {
    "usual": np.eye(3),
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
# A just noticeable difference is about 2.3; lines of 2 pixels need some nine of them to be told apart at a glance.
APART = 20.0


def linear(colour: str) -> np.ndarray:
    """Return linear RGB of a colour: the curve of sRGB undone."""
    level = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)


def mixed(colour: str, paper: str, opacity: float) -> str:
    """Return the colour that a translucent dot has on its paper."""
    parts = ((int(colour[k : k + 2], 16), int(paper[k : k + 2], 16)) for k in (1, 3, 5))
    return "#" + "".join(f"{round(opacity * a + (1.0 - opacity) * b):02x}" for a, b in parts)


def lab(rgb: np.ndarray) -> np.ndarray:
    """Return CIE L*a*b* under D65."""
    ratio = TO_XYZ @ np.clip(rgb, 0.0, 1.0) / np.array([0.95047, 1.0, 1.08883])
    f = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("colours", [LIGHT, DARK], ids=["light", "dark"])
@pytest.mark.parametrize("vision", VISION)
def test_series_are_told_apart(colours, vision):
    seen = {role: lab(np.asarray(VISION[vision]) @ linear(colour)) for role, colour in colours.items()}
    closest = min(itertools.combinations(seen, 2), key=lambda pair: np.linalg.norm(seen[pair[0]] - seen[pair[1]]))
    assert np.linalg.norm(seen[closest[0]] - seen[closest[1]]) > APART, f"{closest} look alike: {vision}"


@pytest.mark.parametrize(("colours", "paper"), [(LIGHT, PAPER["light"]), (DARK, PAPER["dark"])])
def test_series_are_seen_on_their_paper(colours, paper):
    """WCAG 2.2 asks graphics for a contrast of 3 with what is behind them, dots of a cloud too."""
    behind = TO_XYZ[1] @ linear(paper)
    for role, colour in colours.items():
        for shown in (colour, mixed(colour, paper, DOTS.get(role, 1.0))):
            bright, dim = sorted([TO_XYZ[1] @ linear(shown), behind], reverse=True)
            assert (bright + 0.05) / (dim + 0.05) >= 3.0, role


def test_pages_take_dashes_and_opacities_from_the_palette():
    script = (Path(palette.__file__).parents[1] / "workflows" / "report" / "views.js").read_text(encoding="utf-8")
    for name, known in (("DOTS", DOTS), ("DASHES", palette.DASHED)):
        written = re.search(rf"const {name} = (\{{.*?\}});", script)[1]
        assert json.loads(re.sub(r"(\w+):", r'"\1":', written)) == known


def test_the_measure_knows_confusable_colours():
    """Red and green of one lightness, which deuteranopes confuse, are rejected by the same measure."""
    pair = [lab(np.asarray(VISION["deuteranopia"]) @ linear(colour)) for colour in ("#b55a30", "#7d7a20")]
    assert np.linalg.norm(pair[0] - pair[1]) < APART
