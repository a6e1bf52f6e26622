"""The 1 kHz loop on hardware: bus and control in one process, learning in another, shared memory between them.

Read in this order: `pace` (when a tick begins), `board` (messages between the processes), `loop` (a tick, and the
state machine), `process` (the real-time process), `session` (that process seen from the one that started it),
`realtime_plant` (the `Plant` of the learning process).
"""
