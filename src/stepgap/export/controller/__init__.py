"""A learned controller in a form that other programs can compute: a few kinds of maps, each with a formula."""
