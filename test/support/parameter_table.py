"""Writes docs/parameters.md: every parameter of simulator, controller and dashboard, as the nodes describe it."""

import argparse
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from backlash_ros.nodes.controller import Controller
from backlash_ros.nodes.parameters import declare_dashboard
from backlash_ros.nodes.plant_simulator import PlantSimulator
from backlash_ros.ros.isolation import isolated

Described = dict[str, tuple[Any, ...]]
"""Descriptor and default by name; and in words where it may change, if that is not the descriptor's alone."""

FROM_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""What rclpy declares by itself, not told here."""

_UNIT = re.compile(r" \[([^]]+)\]$")

HEADER = """# Parameters

Made from the code by `make docs`; a test keeps it so. The same, from a node that runs: `ros2 param describe`.

*read-only* parameters are given at the start. *dynamic* ones may be changed while the node runs and act from the
next sample on; what is found of a drive once it is there is dynamic in the controller. A request is validated together
with everything else that is set, and taken whole or not at all (`set_parameters_atomically`; `ros2 param set` and
`load` send their parameters one by one, and each has to be valid with those before it). A refusal names the parameter,
the value and the bound. Whole numbers stand for floats. No parameter can be deleted.

What is in use is published on `~/parameters_in_use` (rcl_interfaces/ParameterEvent, transient local) under
`new_parameters`: every parameter, and an integer `version` that rises by one with each request that is taken.
`~/learn` sets `backlash_angle` in the same way, `~/identify` what it has found of the drive, and `~/apply_estimate`
either. The recorder keeps the topic; `read_bag` gives it as `in_use`, and what the simulator says of itself as
`simulated`.

Besides these every node has `use_sim_time` and `start_type_description_service`, which are ROS's own, and
`qos_overrides.*` for its topics.
"""

BOTH = """Simulator and controller must be told the same drive, but for what the controller finds by itself.

Where the drive changes in the controller, gains that were designed from weights are designed anew, `faults.*` that
were the old drive's defaults become the new one's, and every gain set has to be stable.
"""

GAINS = """`gains.<region>.k` is always what is in use. It comes from one of three places:

- `gain_set` names a set from `gain_set_names`; choosing it sets both regions' gains. Sets are given in the parameter
  file, under `gain_sets.<name>`, each region by either `k` or `q`; the `nominal` one has defaults.
- `gains.<region>.q` are LQR weights of eq 14, from which `k` is designed.
- `gains.<region>.k` are gains as numbers; the region's `q` becomes [0, 0].

The last two make `gain_set` `custom`, which may also be set: it changes no gains. A request that contradicts itself,
such as a set together with other gains, is refused. So are gains with which the sampled loop would be unstable even
without backlash.
"""

LIMITS = """What is clamped or refused. The default of `command` follows from the drive; here it is that of the nominal
one. Ends of the travel are refused where the reference in use would be outside of them. A load that is found outside is
held where it is; the motor gets no command that pushes it further, and a reference inside brings it back. What goes
further beyond an end than `soft_zone` is a fault.
"""

FAULTS = """The thresholds that latch a fault. Their defaults follow from the drive; here they are those of the nominal
one. One that the drive is already beyond when it is set latches its fault at the next sample.

Once `backlash_angle` is set, the shafts may come apart by no more than one and a half of it (or of
`gear.backlash_angle`, the larger), the teeth pressed in and two counts of 12 bit, where `gap` is more. Beside these
thresholds a sample is held against what physics lets it be: [faults.md](faults.md).
"""

LAW_PARAMETERS = "Each law's own, of use with that law alone. A law that is added has its parameters here too.\n"

LEARNING = """A learning run keeps the values that it was started with; changes hold for the next one.
`learning.apply` alone is read when the run ends. [learning.md](learning.md) says what the estimate file is.
"""


DASHBOARD = """What `ros2 run backlash_ros dashboard` takes: [dashboard.md](dashboard.md).
"""


def _dashboard() -> Node:
    node = Node("dashboard")
    declare_dashboard(node)
    return node


def describe_nodes() -> tuple[Described, Described, Described]:
    """Return the parameters of simulator, controller and dashboard, by name: descriptor and default."""
    with isolated():
        rclpy.init(args=[])
        try:
            return _described(PlantSimulator), _described(Controller), _described(_dashboard)
        finally:
            rclpy.shutdown()


def _described(make: Callable[[], Node]) -> Described:
    node = make()
    names = [name for name in node.list_parameters([], 0).names if not name.startswith(FROM_ROS)]
    described = {name: (node.describe_parameter(name), node.get_parameter(name).value) for name in names}
    node.destroy_node()
    return described


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, (str, bool, int)):
        return str(value).lower() if isinstance(value, bool) else str(value)
    return f"[{', '.join(map(_value, value))}]"


def _row(name: str, described: ParameterDescriptor, default: Any, change: str = "") -> str:
    change = change or ("read-only" if described.read_only else "dynamic")
    unit = "".join(_UNIT.findall(described.description))
    bound = described.additional_constraints
    if described.floating_point_range and unit:
        bound = re.sub(rf"(?<=\d) {re.escape(unit)}(?= |$)", "", bound)
    cells = (
        f"`{name}`",
        Parameter.Type(described.type).name.lower().replace("_", " "),
        _value(default),
        unit,
        bound,
        change,
        _UNIT.sub("", described.description),
    )
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _section(title: str, text: str, parameters: Described) -> str:
    heading = "| parameter | type | default | unit | range | change | meaning |\n|---|---|---|---|---|---|---|"
    rows = "\n".join(_row(name, *parameters[name]) for name in parameters)
    return f"\n## {title}\n\n{text}\n{heading}\n{rows}\n"


def _of_both(simulator: tuple[Any, ...], controller: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return what to say of a parameter of both nodes, which has to mean the same in both."""
    (described, default), (other, other_default) = simulator, controller
    fixed = described.read_only, other.read_only
    described.read_only = other.read_only = True
    assert (described, default) == (other, other_default), described.name
    return described, default, {(True, True): "read-only", (True, False): "dynamic in the controller"}[fixed]


def parameter_table() -> str:
    """Return the page."""
    simulator, controller, dashboard = describe_nodes()
    plain_first = sorted(simulator, key=lambda name: "." in name)
    shared = {name: _of_both(simulator[name], controller[name]) for name in plain_first if name in controller}
    own = {name: described for name, described in controller.items() if name not in shared}
    sets = ("gain_set", "gains.")

    def part(*prefixes: str) -> Described:
        return {name: described for name, described in own.items() if name.startswith(prefixes)}

    rest = {name: own[name] for name in own if not name.startswith((*sets, "laws.", "limits.", "faults.", "learning."))}
    gains = {name.replace(".nominal.", ".<name>."): described for name, described in part(*sets).items()}
    return HEADER + "".join(
        (
            _section(
                "Both nodes",
                BOTH,
                shared,
            ),
            _section("Simulator", "", {name: simulator[name] for name in simulator if name not in shared}),
            _section("Controller", "", rest),
            _section("Laws", LAW_PARAMETERS, part("laws.")),
            _section("Gains", GAINS, gains),
            _section("Limits", LIMITS, part("limits.")),
            _section("Faults", FAULTS, part("faults.")),
            _section("Learning", LEARNING, part("learning.")),
            _section("Dashboard", DASHBOARD, dashboard),
        )
    ).replace("\n\n\n", "\n\n")


def main(args: Sequence[str] | None = None) -> int:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/parameters.md"), help="file to write")
    parser.parse_args(args).out.write_text(parameter_table())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
