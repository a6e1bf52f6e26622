"""The hopper on its buses, real and emulated: settings, calibration, the trial of its motors."""
