"""``python -m vpfx``: the same as the command ``vpfx``."""

from vpfx.cli import main

if __name__ == "__main__":
    main()
