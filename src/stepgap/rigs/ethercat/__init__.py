"""The robot on an EtherCAT ring: torque-controlled drives and boom encoders."""
