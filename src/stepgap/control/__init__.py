"""Control of steps with any `StepMap`; knows no robot.

Read `reference` (what is desired at each step), then `step_controller` (the command whose predicted next state is the
desired one), `goal` (what is wanted of a next state, also where states are not tracked), `horizon` (with a view to the
steps after it) and `cautious_controller` (the command where the map is not certain), then `limit_cycle` (which states
can be held, whether they are stable, and the one-step reachable set) and `reach` (what commands can do). All of them
minimise by `gauss_newton`, and by `bounded_search` without a good start, from the commands of `box_points`.
`command_table` interpolates solved commands.
"""
