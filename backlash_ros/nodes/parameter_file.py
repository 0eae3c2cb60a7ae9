"""A parameter file to start from: every parameter of the nodes with its default, commented (`backlash params`)."""

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import yaml
from rcl_interfaces.msg import ParameterDescriptor

from backlash_ros.foundation.reading.parameter_files import in_sections
from backlash_ros.nodes.fixed_parameters import declare_controller, declare_dashboard, declare_simulator
from backlash_ros.nodes.tunables import declare_tunables
from backlash_ros.ros.parameters import Declarations, declare_autostart, in_parts

Described = Mapping[str, tuple[ParameterDescriptor, Any]]
"""Descriptor and default of parameters, by name."""

_DERIVED = {"limits.command", "faults", "gains"}
"""Parameters and sections whose defaults follow from other parameters: they are comments, so that they still follow."""

_WIDTH = 105
"""Of a comment, characters."""
_HEAD = """\
# Every parameter of {nodes}, with its default: keep what you change. SI units, angles in rad.
#
#   ros2 run backlash_ros {node} --ros-args --params-file my_drive.yaml
#
# "/**" means any node in any namespace; each node uses the parameters that it knows. Simulator and controller must have
# the same drive. Values that are comments follow from other parameters; remove the "#" to set them."""


def _simulator(node: Any) -> None:
    declare_autostart(node)
    declare_simulator(node)


def _controller(node: Any) -> None:
    declare_autostart(node)
    given = declare_controller(node)
    declare_tunables(node, given.drive, given.rate)


_DECLARE: Mapping[str, Callable[[Any], object]] = {
    "plant_simulator": _simulator,
    "controller": _controller,
    "dashboard": declare_dashboard,
}


def parameters_of(node: str) -> Described:
    """Return the parameters of a node: "plant_simulator", "controller" or "dashboard"."""
    declarations = Declarations()
    _DECLARE[node](declarations)
    return declarations.declared


def _comment(descriptor: ParameterDescriptor) -> Iterator[str]:
    text, unit, bound = in_parts(descriptor)
    told = f"{text} [{unit}]" if unit else text
    whole = f"{told}; {bound}"
    for part in [whole] if bound and len(whole) <= _WIDTH else [told, bound]:
        for line in textwrap.wrap(part, _WIDTH, break_on_hyphens=False):
            yield f"# {line}"


def _lines(sections: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the lines of a section: first its own parameters, then its subsections."""
    for key, content in sorted(sections.items(), key=lambda item: isinstance(item[1], dict)):
        name = f"{prefix}{key}"
        if isinstance(content, dict):
            lines = [f"{key}:", *(f"  {line}" for line in _lines(content, f"{name}."))]
        else:
            descriptor, default = content
            yield from _comment(descriptor)
            lines = [f"{key}: {yaml.safe_dump([default], default_flow_style=True, width=1000).strip()[1:-1]}"]
        yield from (f"# {line}" for line in lines) if name in _DERIVED else lines


def parameter_file(nodes: Sequence[str]) -> str:
    """Return the text of a parameter file for ``nodes`` (see `parameters_of`): every parameter, with its default."""
    each = {node: parameters_of(node) for node in nodes}
    groups: dict[str, dict[str, Any]] = {}
    for name, content in (item for parameters in each.values() for item in parameters.items()):
        owners = [node for node in nodes if name in each[node]]
        groups.setdefault("" if owners == list(nodes) else f"# {owners[0]} only", {})[name] = content
    lines = [_HEAD.format(nodes=" and ".join(nodes), node=nodes[-1]), "/**:", "  ros__parameters:"]
    for title, parameters in groups.items():
        lines += ["", f"    {title}"] if title else []
        lines += [f"    {line}" for line in _lines(in_sections(parameters))]
    return "\n".join(lines) + "\n"
