"""`python -m omnistereo_lib COMMAND`, the same as `omnistereo COMMAND`."""

from omnistereo_lib.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
