"""MultibodyPlant with hydroelastic or point contact as an engine."""
