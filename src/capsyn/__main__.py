"""``python -m capsyn``."""

from capsyn.cli import main

main()
