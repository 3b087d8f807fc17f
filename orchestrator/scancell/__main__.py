"""`python -m scancell`: the command `scancell`."""

from scancell.cli import main

if __name__ == "__main__":
    main()
