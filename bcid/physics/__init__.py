"""The equations of a planar vehicle, each a small pure function in the paper's symbols.

Frames: world x, y on the floor and yaw counter-clockwise; body x forward, y left; SI units.  `kinematics` (frames,
slip angles), `tyres`, `motor`, `steering`, `elementary` and `elementary_single` (fast functions), `car` (all together,
one period).  Source: arXiv 2512.02803, cited as "paper"; its misprints are corrected as the errata's rows say.
"""
