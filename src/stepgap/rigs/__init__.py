"""Rigs: the hardware of a robot, or a simulation of it; they give sensor counts and take torques.

`Rig` is the interface, which the twin, the EtherCAT drives and the moteus controllers implement.
"""
