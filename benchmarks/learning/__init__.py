"""The learning benchmark: ways to learn, compared on a family of random twins; `methods` has one file per family."""
