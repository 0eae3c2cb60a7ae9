"""The parser of every command: what is wrong with the arguments is one line, and the exit code 2."""

import argparse
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """A parser with one-line error messages."""

    def error(self, message: str) -> NoReturn:
        """End with exit code 2."""
        self.exit(2, f"{self.prog}: {message}\n")
