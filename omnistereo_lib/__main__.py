"""`python -m omnistereo_lib VERB`: the library's verbs for long or unattended work."""

from omnistereo_lib.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
