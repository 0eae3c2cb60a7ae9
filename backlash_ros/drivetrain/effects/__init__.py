"""What real axes have beside the paper's equations: cogging, friction that changes with speed, a sagging supply, ...

`parameters` names every effect, with its size; the default is none of them. The other files have one effect each, and
`equations`, `explicit`, `implicit` and `kinks` move a drive that has some. A drive without effects is moved by `motion`
alone.
"""

from backlash_ros.drivetrain.effects.parameters import Effects

__all__ = ["Effects"]
