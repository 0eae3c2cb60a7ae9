"""`backlash live`: runs a simulated drive, its controller and the page."""

from backlash_ros.commands.command import program

COMMAND = program("backlash_ros.dashboard.live")
