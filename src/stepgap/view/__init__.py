"""What goes on in a run, as a page in the browser.

`geometry` says where every joint is, `motion` how the robot moved in a hop, `source` what there is to show of a run;
`player` decides which moment is shown, `robot_scene`, `plots` and `page` show it. `watch` serves the page, `live` feeds
it from a run that goes on, in a process of its own: no fault of the page disturbs a run.
"""
