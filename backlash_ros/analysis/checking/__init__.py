"""`backlash check`: checks a drive file and its loop before anything moves."""

from backlash_ros.analysis.checking.check import Checked, Warned, check_drive

__all__ = ["Checked", "Warned", "check_drive"]
