"""What moves: sensor counts in, torques out. `Rig` is the seam; the twin and the EtherCAT drives implement it."""
