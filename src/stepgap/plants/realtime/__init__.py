"""The 1 kHz loop on hardware: bus and control in one process, learning in another, shared memory between them.

Read in this order: `states` (what may follow what), `pace` (when a tick begins), `board` (what the processes tell each
other), `loop` (a tick), `process` (the process around it), `session` (that process seen from the one that started it),
`realtime_plant` (the `Plant` of the process that learns).
"""
