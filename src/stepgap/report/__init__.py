"""Reports: figures and page of a run, and the comparison of several runs.

A report is made from a `Run` alone. Nothing here builds a plant or a twin, except to simulate a lost replay again.

`analysis` computes what is learned and the limit cycles; the modules in `figures` each draw and describe some figures;
`tables`, `learned_table` and `gait_table` make the tables, `sentences`, `diagnosis_sentences`,
`reach_sentences` and `trust_sentences` the text, `replay_view` the replay. `page` puts all on one page, next to
published results, and lists the missing parts. `html` and `drawing` are for all pages.
"""
