"""What nodes and their clients share: topics, messages, parameters from dataclasses, lifecycle, run, isolation."""
