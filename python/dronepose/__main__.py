"""``python -m dronepose`` is the command ``dronepose``."""

import sys

from dronepose.cli import dronepose

if __name__ == "__main__":
    sys.exit(dronepose())
