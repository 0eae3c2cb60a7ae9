"""`backlash demo`: runs the demo."""

from backlash_ros.commands.command import program

COMMAND = program("backlash_ros.demo.__main__")
