"""Run occmap as `python -m occmap`."""

from occmap.cli import main

if __name__ == "__main__":
    main()
