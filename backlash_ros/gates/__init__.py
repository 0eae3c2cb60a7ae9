"""Which samples a controller takes, which commands a drive takes, and what is a fault: without ROS, for any adapter."""

from backlash_ros.gates.command_gate import CommandGate
from backlash_ros.gates.faults import FAULTS, Fault, Meaning
from backlash_ros.gates.publishers import Publishers
from backlash_ros.gates.sample_gate import Action, Judged, SampleGate

__all__ = ["FAULTS", "Action", "CommandGate", "Fault", "Judged", "Meaning", "Publishers", "SampleGate"]
