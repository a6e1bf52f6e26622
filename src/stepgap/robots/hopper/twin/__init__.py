"""The twin: a MuJoCo stand-in for the real robot, apart from the physics model by a declared `RealityGap`."""
