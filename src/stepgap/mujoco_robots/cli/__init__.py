"""The forms of `stepgap new` that begin with files of others."""
