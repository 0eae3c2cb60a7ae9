"""What every node loads, looks up and works out, done; a process that has imported this is forked for each node."""

import gc
import inspect
import sys

import rosbags.typesys.stores.ros2_jazzy  # noqa: F401
from rclpy.type_support import check_for_type_support

import backlash_ros.dashboard.command
import backlash_ros.dashboard.page
import backlash_ros.nodes.controller
import backlash_ros.nodes.plant_simulator
import backlash_ros.nodes.recorder  # noqa: F401
from backlash_ros.control import DEFAULT_WEIGHTS, design_gains
from backlash_ros.control.design.stability import stability_margins
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.simulation.__main__ import main

main()
for region, weights in DEFAULT_WEIGHTS.items():  # the controller's first words
    stability_margins(NOMINAL_DRIVE, design_gains(region, NOMINAL_DRIVE, weights), 0.004, 0.0)
inspect.getmodule(inspect.currentframe())  # the log asks for the file of every module with its first line
for name in [name for name in sys.modules if name.endswith((".msg", ".srv"))]:
    for kind in vars(sys.modules[name]).values():
        if hasattr(type(kind), "__import_type_support__"):
            check_for_type_support(kind)
# A node looks for garbage once when it starts, and finds none of this.
gc.collect()
gc.freeze()
