"""Reports: figures and page of a run, and the comparison of several runs.

A report is made from a `Run` alone. Nothing here builds a plant or a twin, except to simulate a lost replay again.

`analysis` computes what is learned and the limit cycles; the modules in `figures` each draw and describe some figures;
`tables` and `learned_table` make the tables, `sentences` and `diagnosis_sentences` the text, `gait_text` both of the
gait, `replay_view` the replay. `page` puts all on one page, next to published results, and lists the
missing parts. `html` and `drawing` are for all pages.
"""
