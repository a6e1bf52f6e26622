"""The page that shows a run in the browser.

`source` has all data of a run; `player` chooses the moment that is drawn; `robot_scene` and `page` draw it.
`watch` serves the page. For a run in progress, `live` serves it in a separate process, so that no fault of the page
disturbs the run.
"""
