"""Colours of every chart, by what a series is; told apart by all common forms of colour vision.

`tests/plots/test_palette.py` computes the distances under simulated deficiencies and the contrast with the paper.
"""

#: What a series is, in the order in which colours are handed out to further ones.
ROLES = ("measured", "simulated", "corrected", "learned", "nominal", "other")
LIGHT = dict(zip(ROLES, ("#1b1f27", "#169ae9", "#ba7c3b", "#167b52", "#6d26eb", "#cb4293"), strict=True))
DARK = dict(zip(ROLES, ("#f2f3f5", "#2b89a7", "#b56a34", "#2eea79", "#984ccb", "#d01453"), strict=True))
#: The grounds that charts are drawn on.
PAPER = {"light": "#ffffff", "dark": "#171a20"}
#: Opacity of dots, 1 for roles that are not named: at half of it only the measured ones keep a contrast of 3.
DOTS = {"measured": 0.5}
#: Roles whose lines are dashed as well, for print in grey.
DASHED = {"nominal": "6 3", "corrected": "10 3", "other": "2 3"}
