"""`python -m stepgap` is the program `stepgap`."""

from stepgap.cli.start import start

if __name__ == "__main__":
    start()
