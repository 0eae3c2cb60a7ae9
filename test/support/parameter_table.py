"""Writes docs/parameters.md: every parameter of simulator, controller and dashboard, as the nodes declare it."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.parameter import Parameter

from backlash_ros.nodes.parameter_file import parameters_of
from backlash_ros.ros.parameters import in_parts

Described = Mapping[str, tuple[Any, ...]]
"""Descriptor and default by name; and in words where it may change, if the descriptor alone does not say it."""

FROM_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Parameters that rclpy declares by itself, which are not listed here."""

HEADER = """# Parameters

Made from the code by `make docs`; a test checks that it is current. A running node shows the same: `ros2 param
describe`.

`backlash params --out my_drive.yaml` writes all parameters of simulator and controller as a commented parameter file
with their defaults (`backlash params controller` only those of the controller).

*read-only* parameters are set at the start. *dynamic* ones may be changed while the node runs and act from the next
sample on; in the controller, the values that identification finds are dynamic. A request is validated together with
all other parameters, and accepted as a whole or not at all (`set_parameters_atomically`; `ros2 param set` and `load`
send their parameters one by one, and each must be valid with the previous ones). A refusal names the parameter, the
value and the bound. Whole numbers are accepted for floats. No parameter can be deleted.

The parameters in use are published on `~/parameters_in_use` (rcl_interfaces/ParameterEvent, transient local) under
`new_parameters`: every parameter, and an integer `version` that rises by one with each accepted request. `~/learn`
sets `backlash_angle` in the same way, `~/identify` the values that it found, and `~/apply_estimate` either. The
recorder stores the topic; `read_bag` returns it as `in_use`, and the simulator's as `simulated`.

Every node also has ROS's own `use_sim_time` and `start_type_description_service`, and `qos_overrides.*` for its
topics.
"""

BOTH = """Simulator and controller must have the same drive, except for the values that the controller finds by
itself.

When the controller's drive changes, gains from weights are designed again, `faults.*` that were the old drive's
defaults become the new one's, and every gain set must be stable.
"""

SIMULATOR = """`effects.*` are what real axes have and the equations of the drive lack. By default there are none, and
no controller is told of them. [evaluation.md](evaluation.md#the-effects-of-real-axes) has the usual size of each.
"""

GAINS = """`gains.<region>.k` are always the gains in use. They come from one of three places:

- `gain_set` names a set from `gain_set_names`; choosing it sets both regions' gains. Sets are defined in the parameter
  file, under `gain_sets.<name>`, each region by either `k` or `q`; the `nominal` set has defaults.
- `gains.<region>.q` are LQR weights of eq 14, from which `k` is designed.
- `gains.<region>.k` are gains as numbers; the region's `q` becomes [0, 0].

The last two make `gain_set` `custom`; setting `custom` itself changes no gains. A request that contradicts itself,
such as a set together with other gains, is refused. So are gains with which the sampled loop would be unstable even
without backlash, or inside the gap, where the motor turns alone; at the start the refusal names values that are stable.

The default weights, [1000, 1] and [4, 0], are divided by four until the loop is stable at the rate and with the delay;
where they are stable they stay. Other weights are taken as they are given.
"""

LIMITS = """Limits that clamp or refuse. The default of `command` follows from the drive; the table shows the nominal
drive's. Ends of the travel are refused if the present reference would be outside of them. A load found outside is
held where it is; the motor gets no command that pushes it further, and a reference inside brings it back. A load more
than `soft_zone` beyond an end is a fault.
"""

FAULTS = """Thresholds that latch a fault. Their defaults follow from the drive; the table shows those of the nominal
drive. If the drive already exceeds a threshold when it is set, the fault is latched at the next sample.

Once `backlash_angle` is set, the shafts may move apart by at most 1.5 times the larger of it and
`gear.backlash_angle`, plus the wind-up of the teeth and two counts of 12 bit, unless `gap` is smaller. Samples are
also checked for physical plausibility: [faults.md](faults.md).
"""

LAW_PARAMETERS = "Each law has its own parameters, which only that law uses. So does a law that you add.\n"

LEARNING = """A learning run keeps the values with which it started; changes apply to the next run. Only
`learning.apply` is read when the run ends. [learning.md](learning.md) explains the estimate file.
"""


DASHBOARD = """Parameters of `ros2 run backlash_ros dashboard`: [dashboard.md](dashboard.md).
"""


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, (str, bool, int)):
        return str(value).lower() if isinstance(value, bool) else str(value)
    return f"[{', '.join(map(_value, value))}]"


def _row(name: str, described: ParameterDescriptor, default: Any, change: str = "") -> str:
    change = change or ("read-only" if described.read_only else "dynamic")
    text, unit, bound = in_parts(described)
    cells = (
        f"`{name}`",
        Parameter.Type(described.type).name.lower().replace("_", " "),
        _value(default),
        unit,
        bound,
        change,
        text,
    )
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _section(title: str, text: str, parameters: Described) -> str:
    heading = "| parameter | type | default | unit | range | change | meaning |\n|---|---|---|---|---|---|---|"
    rows = "\n".join(_row(name, *parameters[name]) for name in parameters)
    return f"\n## {title}\n\n{text}\n{heading}\n{rows}\n"


def _of_both(simulator: tuple[Any, ...], controller: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the row of a parameter of both nodes, which must mean the same in both."""
    (described, default), (other, other_default) = simulator, controller
    fixed = described.read_only, other.read_only
    described.read_only = other.read_only = True
    assert (described, default) == (other, other_default), described.name
    return described, default, {(True, True): "read-only", (True, False): "dynamic in the controller"}[fixed]


def parameter_table() -> str:
    """Return the page."""
    simulator, controller, dashboard = map(parameters_of, ("plant_simulator", "controller", "dashboard"))
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
            _section("Simulator", SIMULATOR, {name: simulator[name] for name in simulator if name not in shared}),
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
