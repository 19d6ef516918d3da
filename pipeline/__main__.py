"""`python -m pipeline ...`: every command but the window."""

from pipeline.cli.main import main

if __name__ == "__main__":
    main()
