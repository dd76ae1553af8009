"""`python -m render`: the data sets, rendered with Blender."""

from render import main

if __name__ == "__main__":
    raise SystemExit(main())
