"""Subcommands of ``dronepose`` written in Python, a module each; see :mod:`dronepose.cli`."""
