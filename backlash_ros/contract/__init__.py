"""The drive contract kit: pytest checks that a node is a drive, see docs/contract.md."""
