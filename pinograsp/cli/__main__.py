"""``python -m pinograsp.cli`` is the command ``pinograsp``."""

from pinograsp.cli import main

main()
