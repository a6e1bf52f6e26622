"""The methods that `stepgap bench learning` compares, one file per family; `registry` lists them by name."""
