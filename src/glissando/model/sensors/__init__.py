"""The sensors: readings, what each expects of a state, parameters not known exactly."""
