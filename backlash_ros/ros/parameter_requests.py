"""The services that set parameters: every request is answered, and a refusal names the parameter.

rclpy's own answers do not name a parameter that has the wrong type, is deleted or does not exist, and a value of an
unknown type crashes the node.
"""

from collections.abc import Sequence

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_service import ParameterService

from backlash_ros.ros.parameters import check_kind, convert


def read_request(node: Node, messages: Sequence[ParameterMessage]) -> list[Parameter]:
    """Return the changes of a request, in the declared types of the parameters; ValueError names a refused one.

    A read-only parameter may be set to its present value, so that a file of all parameters can be loaded again.
    """
    names = [message.name for message in messages]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name} is in the request {names.count(name)} times")
    parameters = [_read(node, message) for message in messages]
    return [parameter for parameter in parameters if not node.describe_parameter(parameter.name).read_only]


def _read(node: Node, message: ParameterMessage) -> Parameter:
    name = message.name
    if not node.has_parameter(name):
        raise ValueError(f"there is no parameter {name!r}")
    described = node.describe_parameter(name)
    kind, constraint = Parameter.Type(described.type), described.additional_constraints
    try:
        value = convert(parameter_value_to_python(message.value), kind)
    except RuntimeError as error:
        raise ValueError(f"{name}: {error}") from error
    if described.read_only:
        now = node.get_parameter(name).value
        if value != now:
            raise ValueError(f"{name} is read-only: it stays {now!r} while the node runs, got {value!r}")
        return node.get_parameter(name)
    check_kind(name, value, kind, constraint)
    for bounds in (*described.floating_point_range, *described.integer_range):
        if not bounds.from_value <= value <= bounds.to_value:  # nan is not
            raise ValueError(f"{name} must be {constraint}, got {value!r}")
    return Parameter(name, kind, value)


class ParameterRequests(ParameterService):
    """The parameter services of a node that was created with ``start_parameter_services=False``."""

    def _set(self, messages: Sequence[ParameterMessage]) -> SetParametersResult:
        node = self._get_node()
        try:
            parameters = read_request(node, messages)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return node.set_parameters_atomically(parameters) if parameters else SetParametersResult(successful=True)

    def _set_parameters_callback(
        self, request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        response.results = [self._set([message]) for message in request.parameters]
        return response

    def _set_parameters_atomically_callback(
        self, request: SetParametersAtomically.Request, response: SetParametersAtomically.Response
    ) -> SetParametersAtomically.Response:
        response.result = self._set(request.parameters)
        return response
