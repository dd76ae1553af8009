"""`python -m workshop.render`: the data sets, rendered with Blender."""

from workshop.render import main

if __name__ == "__main__":
    raise SystemExit(main())
