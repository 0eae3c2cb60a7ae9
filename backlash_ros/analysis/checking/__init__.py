"""`backlash check`: what a drive file makes of the loop before anything moves, and what to do about it."""

from backlash_ros.analysis.checking.check import Checked, Warned, check_drive

__all__ = ["Checked", "Warned", "check_drive"]
