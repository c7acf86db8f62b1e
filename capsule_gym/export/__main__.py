"""Exports a policy or a control law: `python -m capsule_gym.export`."""

import sys

from capsule_gym.export.command import main

if __name__ == "__main__":
    sys.exit(main())
