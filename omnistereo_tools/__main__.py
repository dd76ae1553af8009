"""`python -m omnistereo_tools COMMAND`, the same as `omnistereo COMMAND`."""

from omnistereo_tools.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
