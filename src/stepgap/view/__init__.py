"""A run as a page in the browser.

`geometry` gives the position of every joint, `motion` how the robot moved in a hop, `source` all data of a run;
`player` decides which moment is drawn, `robot_scene`, `plots` and `page` show it. `watch` serves the page, `live` feeds
it from a run that is being executed, in a process of its own: no fault of the page disturbs a run.
"""
