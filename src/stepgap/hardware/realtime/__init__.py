"""The 1 kHz loop on hardware: bus and control in one process, learning in another, shared memory between them.

Read in this order: `states` (the state machine), `pace` (when a tick begins), `board` (messages between the processes),
`loop` (a tick), `process` (the real-time process), `session` (that process seen from the one that started it),
`realtime_plant` (the `Plant` of the learning process).
"""
