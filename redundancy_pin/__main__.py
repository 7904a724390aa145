"""``python -m redundancy_pin``: the command line, where the script ``redundancy-pin`` is not on the path."""

from redundancy_pin.cli import main

if __name__ == "__main__":
    main(prog_name="redundancy-pin")
