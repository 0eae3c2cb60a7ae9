"""What every node loads, loaded; a process that has imported this is forked for each node of a test."""

import backlash_ros.nodes.controller
import backlash_ros.nodes.plant_simulator
import backlash_ros.nodes.recorder  # noqa: F401
from backlash_ros.simulation.__main__ import main

main()
